// Draws the frames of one or two walks. While `play` is on, time goes on with the clock.
// What is drawn stays in this tab: nothing of it is sent back to the server.

const HERE = {sync: false}
const SLIDER_MS = 200 // between moves of the slider
let state = null

export default (args, changed) => {
  state ??= begin(args)
  if (changed === args.slider) {
    if (!state.own) state.time = args.slider.value
  } else if (changed.data) { // frames have come
    const ends = args.stages.map(({frames}) => last(frames.data.time_s?.[0]))
    args.slider.setv({end: Math.max(0.1, ...ends)}, HERE)
    if (changed === args.stages[0].frames) state.time = 0
    state.shown += 1
  }
  draw_all(args)
}

function begin(args) {
  const own = {time: 0, before: performance.now(), moved: 0, own: false, shown: 0}
  window.walk_player = own // for tests
  const tick = (now) => {
    const passed = (now - own.before) / 1000
    own.before = now
    if (args.play.active && args.stages[0].frames.data.time_s?.length) {
      own.time += passed * Number(args.speed.value.replace("x", ""))
      if (own.time > args.slider.end) own.time = 0
      draw_all(args)
      if (now - own.moved > SLIDER_MS) {
        own.moved = now
        own.own = true
        args.slider.setv({value: own.time}, HERE)
        own.own = false
      }
    }
    requestAnimationFrame(tick)
  }
  requestAnimationFrame(tick)
  return own
}

function draw_all(args) {
  for (const stage of args.stages) {
    if (stage.frames.data.time_s?.length) draw(stage, state.time, args.levels)
  }
}

function draw({frames, near, far, trunk, head, muscles, forces, figure}, time, levels) {
  const all = frames.data
  const times = all.time_s[0]
  let n = times.length - 1
  while (n > 0 && times[n] > time + 1e-6) n -= 1
  for (const [source, points] of [[near, all.near], [far, all.far], [trunk, all.trunk], [head, all.head]]) {
    put(source.data.x, source.data.y, points[0], n * 2 * source.data.x.length)
    source.change.emit()
  }
  for (const [source, points] of [[muscles, all.muscles], [forces, all.forces]]) {
    const {xs, ys} = source.data
    const size = 2 * xs[0].length
    xs.forEach((x, place) => put(x, ys[place], points[0], (n * xs.length + place) * size))
  }
  const {colour} = muscles.data
  colour.forEach((_, place) => { colour[place] = levels[all.activation[0][n * colour.length + place]] })
  muscles.change.emit()
  forces.change.emit()
  const [x, z] = [all.camera_m[0][2 * n], all.camera_m[0][2 * n + 1]]
  const [width, height] = [figure.x_range.end - figure.x_range.start, figure.y_range.end - figure.y_range.start]
  figure.x_range.setv({start: x - 0.45 * width, end: x + 0.55 * width}, HERE)
  figure.y_range.setv({start: z - 0.3, end: z - 0.3 + height}, HERE)
  const fallen = n === times.length - 1 ? "   end" : ""
  figure.title.setv({text: `${times[n].toFixed(2)} s   ${x.toFixed(2)} m${fallen}`}, HERE)
}

function put(x, y, points, first) {
  for (let i = 0; i < x.length; i++) {
    x[i] = points[first + 2 * i]
    y[i] = points[first + 2 * i + 1]
  }
}

function last(values) {
  return values ? values[values.length - 1] : 0
}
