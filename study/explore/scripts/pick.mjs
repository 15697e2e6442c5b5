// The dot that was clicked: the nearest one of the arms that are shown.
const NEAR_PX = 12

export default ({plot, sources, renderers, arms, clicked}, {x, y}) => {
  const {x_range, y_range, inner_width, inner_height} = plot
  const across = inner_width / (x_range.end - x_range.start)
  const down = inner_height / (y_range.end - y_range.start)
  let [nearest, least] = [null, NEAR_PX]
  sources.forEach(({data}, arm) => {
    if (!renderers[arm].visible) return
    for (let i = 0; i < data.x.length; i++) {
      const away = Math.hypot((data.x[i] - x) * across, (data.y[i] - y) * down)
      if (away < least) [nearest, least] = [[arm, i], away]
    }
  })
  if (nearest === null) return
  const [arm, i] = nearest
  const {run, trial} = sources[arm].data
  clicked.data = {arm: [arms[arm]], run: [run[i]], trial: [trial[i]]}
}
