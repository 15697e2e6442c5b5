// The views of a store's five columns: a cloud of points, histograms and a table, all of the
// rows that `selection` names. It is a text, "column low..high, ...": a brush writes it, a
// person may, and the server reads it. Points are painted as pixels: a hundred thousand in some
// milliseconds on any machine, where WebGL without a GPU takes seconds.

const HERE = {sync: false}
const RANGE = /^\s*(\w+)\s+(\S+?)\.\.(\S+)\s*$/
const PALE = 0xffe0dcd8 // ABGR, as pixels lie in memory
const DARK = 0xff000000
const MOST_ROWS = 200
const NEAR_PX = 14
let state = null

export default (args, event) => {
  state ??= {inside: null, ms: 0, refreshed: 0}
  window.store_view = state // for tests
  if (event.geometry) {
    if (event.final) brush(args, event)
  } else if (event.event_name === "tap") {
    pick(args, event)
  } else if (event === args.table.selected) {
    const [place] = event.indices
    if (place !== undefined) args.row.value = args.table.data.row[place]
  } else if (event === args.plot.x_range || event === args.plot.y_range) {
    paint(args)
  } else {
    refresh(args)
  }
}

// Ranges by the place of their column among the five.
function ranges(args) {
  const found = new Map()
  for (const part of args.selection.value.split(",")) {
    const [, name, low, high] = RANGE.exec(part) ?? []
    const slot = args.columns.findIndex((select) => select.value === name)
    if (slot >= 0 && !isNaN(low) && !isNaN(high)) found.set(slot, [Number(low), Number(high)])
  }
  return found
}

function brush(args, {geometry, origin}) {
  const found = ranges(args)
  const slot = args.histograms.indexOf(origin)
  const bounds = args.bounds.data
  if (origin === args.plot) {
    found.set(0, sorted(geometry.x0, geometry.x1))
    found.set(1, sorted(geometry.y0, geometry.y1))
  } else {
    found.set(slot, sorted(geometry.x0, geometry.x1))
  }
  for (const [place, ends] of found) { // a box up to the edge takes what lies beyond, too
    if (ends[0] <= bounds.low[place]) ends[0] = -Infinity
    if (ends[1] >= bounds.high[place]) ends[1] = Infinity
  }
  const words = [...found].map(([place, ends]) =>
    `${args.columns[place].value} ${ends.map((end) => Number(end.toPrecision(6))).join("..")}`)
  args.selection.value = words.join(", ")
}

function refresh(args) {
  const began = performance.now()
  const data = args.source.data
  const rows = data.c0.length
  const inside = new Uint8Array(rows).fill(1)
  for (const [slot, [low, high]] of ranges(args)) {
    const values = data[`c${slot}`]
    for (let i = 0; i < rows; i++) if (!(values[i] >= low && values[i] <= high)) inside[i] = 0
  }
  const chosen = []
  for (let i = 0; i < rows; i++) if (inside[i]) chosen.push(i)
  Object.assign(state, {inside, all: chosen.length === rows, chosen: chosen.length})
  paint(args)
  count(args, chosen)
  list(args, chosen.slice(0, MOST_ROWS))
  args.count.setv({text: `${chosen.length.toLocaleString("en")} of ${rows.toLocaleString("en")} rows`}, HERE)
  state.ms = performance.now() - began
  state.refreshed += 1
}

// Rows outside the selection first, pale; then those inside, coloured; bred ones last, with a rim.
function paint({source, image, plot, bounds, palette}) {
  const {c0, c1, c2, evolved} = source.data
  const pixels = image.data.image[0]
  const [height, width] = pixels.shape
  const {x_range, y_range} = plot
  const [left, bottom] = [x_range.start, y_range.start]
  const [across, up] = [width / (x_range.end - left), height / (y_range.end - bottom)]
  const low = bounds.data.low[2]
  const scale = palette.length / (bounds.data.high[2] - low || 1)
  const colour = (i) => palette[Math.min(palette.length - 1, Math.max(0, Math.floor((c2[i] - low) * scale)))] ?? DARK
  const square = (i, reach, ink) => {
    const [x, y] = [Math.round((c0[i] - left) * across), Math.round((c1[i] - bottom) * up)]
    if (!(x >= reach && y >= reach && x < width - reach && y < height - reach)) return
    for (let v = y - reach; v <= y + reach; v++) {
      for (let at = v * width + x - reach, end = at + 2 * reach; at <= end; at++) pixels[at] = ink
    }
  }
  pixels.fill(0)
  if (!state.all) for (let i = 0; i < c0.length; i++) if (!state.inside[i]) square(i, 1, PALE)
  for (let i = 0; i < c0.length; i++) if (state.inside[i] && !evolved[i]) square(i, 1, colour(i))
  for (let i = 0; i < c0.length; i++) {
    if (!state.inside[i] || !evolved[i]) continue
    square(i, 3, DARK)
    square(i, 2, colour(i))
  }
  const {x, y, dw, dh} = image.data
  x[0] = left; y[0] = bottom; dw[0] = x_range.end - left; dh[0] = y_range.end - bottom
  image.change.emit()
}

function count({source, bars, bounds}, chosen) {
  bars.forEach((bar, slot) => {
    const values = source.data[`c${slot}`]
    const counts = bar.data.chosen.fill(0)
    const low = bounds.data.low[slot]
    const scale = counts.length / (bounds.data.high[slot] - low || 1)
    for (const i of chosen) {
      const place = Math.floor((values[i] - low) * scale)
      if (!isNaN(place)) counts[Math.max(0, Math.min(place, counts.length - 1))] += 1
    }
    bar.change.emit()
  })
}

function list({source, table, columns}, some) {
  const data = {row: some.map((i) => source.data.row[i]), bred: some.map((i) => source.data.evolved[i] ? "bred" : "")}
  columns.forEach((_, slot) => { data[`c${slot}`] = some.map((i) => source.data[`c${slot}`][i]) })
  table.setv({data}, HERE)
}

function pick({source, plot, image, row}, {x, y}) {
  const {c0, c1} = source.data
  const [height, width] = image.data.image[0].shape
  const [across, up] = [width / (plot.x_range.end - plot.x_range.start), height / (plot.y_range.end - plot.y_range.start)]
  let [nearest, least] = [-1, NEAR_PX]
  for (let i = 0; i < c0.length; i++) {
    if (!state.inside[i]) continue
    const away = Math.hypot((c0[i] - x) * across, (c1[i] - y) * up)
    if (away < least) [nearest, least] = [i, away]
  }
  if (nearest >= 0) row.value = source.data.row[nearest]
}

function sorted(one, other) {
  return one < other ? [one, other] : [other, one]
}
