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
    const place = nearest(args, event)
    if (place >= 0) args.row.value = args.source.data.row[place]
  } else if (event.event_name === "mousemove" || event.event_name === "mouseleave") {
    point_at(args, event.event_name === "mousemove" ? nearest(args, event) : -1)
  } else if (event === args.row) {
    mark(args)
  } else if (event === args.table.selected) {
    const [place] = event.indices
    if (place !== undefined) args.row.value = args.table.data.row[place]
  } else if (event === args.plot.x_range || event === args.plot.y_range) {
    paint(args)
  } else {
    refresh(args)
  }
}

// Ranges by the names of their columns, of the five and of others.
function ranges(args) {
  const found = new Map()
  for (const part of args.selection.value.split(",")) {
    const [, name, low, high] = RANGE.exec(part) ?? []
    if (name && !isNaN(low) && !isNaN(high)) found.set(name, [Number(low), Number(high)])
  }
  return found
}

function brush(args, {geometry, origin}) {
  const found = ranges(args)
  const bounds = args.bounds.data
  const take = (slot, ends) => { // a box up to the edge takes what lies beyond, too
    ends.sort((one, other) => one - other)
    if (ends[0] <= bounds.low[slot]) ends[0] = -Infinity
    if (ends[1] >= bounds.high[slot]) ends[1] = Infinity
    found.set(args.columns[slot].value, ends)
  }
  if (origin === args.plot) {
    take(0, [geometry.x0, geometry.x1])
    take(1, [geometry.y0, geometry.y1])
  } else {
    take(args.histograms.indexOf(origin), [geometry.x0, geometry.x1])
  }
  const words = [...found].map(([name, ends]) => `${name} ${ends.map((end) => Number(end.toPrecision(6))).join("..")}`)
  args.selection.value = words.join(", ")
}

function refresh(args) {
  const began = performance.now()
  const data = args.source.data
  const rows = data.c0.length
  const inside = Uint8Array.from(data.kept) // by ranges of columns that are not among the five
  for (const [name, [low, high]] of ranges(args)) {
    const slot = args.columns.findIndex((select) => select.value === name)
    if (slot < 0) continue
    const values = data[`c${slot}`]
    for (let i = 0; i < rows; i++) if (!(values[i] >= low && values[i] <= high)) inside[i] = 0
  }
  const chosen = []
  for (let i = 0; i < rows; i++) if (inside[i]) chosen.push(i)
  Object.assign(state, {inside, all: chosen.length === rows, chosen: chosen.length})
  paint(args)
  count(args, chosen)
  list(args, chosen.slice(0, MOST_ROWS))
  mark(args)
  args.count.setv({text: `${chosen.length.toLocaleString("en")} of ${rows.toLocaleString("en")} rows`}, HERE)
  state.ms = performance.now() - began
  state.refreshed += 1
}

// Rows outside the selection first, pale; then those inside, coloured; bred ones last, with a rim.
function paint({source, image, plot, bounds, palette}) {
  const {c0, c1, c2, evolved} = source.data
  let pixels = image.data.image[0]
  const laid_out = !plot.properties.inner_width.is_unset && plot.inner_width > 0 && plot.inner_height > 0
  const [height, width] = laid_out ? [plot.inner_height, plot.inner_width].map(Math.round) : pixels.shape
  if (height !== pixels.shape[0] || width !== pixels.shape[1]) {
    pixels = new pixels.constructor(height * width, [height, width])
    image.data.image = [pixels]
  }
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

function list({source, table, columns, listing}, some) {
  const data = {row: some.map((i) => source.data.row[i]), bred: some.map((i) => source.data.evolved[i] ? "bred" : "")}
  columns.forEach((_, slot) => { data[`c${slot}`] = some.map((i) => source.data[`c${slot}`][i]) })
  table.setv({data}, HERE)
  listing.children[0].view.change.emit() // a table does not see other rows if they are as many
}

// The place of the row nearest to the pointer, or -1.
function nearest({source, plot}, {x, y}) {
  const {c0, c1} = source.data
  const [across, up] = [plot.inner_width / (plot.x_range.end - plot.x_range.start), plot.inner_height / (plot.y_range.end - plot.y_range.start)]
  let [found, least] = [-1, NEAR_PX]
  for (let i = 0; i < c0.length; i++) {
    if (!state.inside[i]) continue
    const away = Math.hypot((c0[i] - x) * across, (c1[i] - y) * up)
    if (away < least) [found, least] = [i, away]
  }
  return found
}

function point_at({source, plot, rings, bounds}, place) {
  if (place === state.pointed) return
  state.pointed = place
  const number = (slot) => `${bounds.data.words[slot]} ${Number(source.data[`c${slot}`][place].toPrecision(4))}`
  const text = place < 0 ? " " : [`row ${source.data.row[place]}`, number(0), number(1), number(2)].join(", ")
  plot.title.setv({text}, HERE)
  ring(rings, 1, source.data, place)
}

// The row that walks: a ring in the cloud, a line in each histogram, a colour in the table.
function mark({source, rings, spans, row, table}) {
  const place = source.data.row.indexOf(row.value)
  ring(rings, 0, source.data, place)
  spans.forEach((span, slot) => span.setv({location: place < 0 ? null : source.data[`c${slot}`][place]}, HERE))
  const listed = table.data.row.indexOf(row.value)
  table.selected.setv({indices: listed < 0 ? [] : [listed]}, HERE)
}

function ring(rings, which, {c0, c1}, place) {
  const {x, y} = rings.data
  x[which] = place < 0 ? NaN : c0[place]
  y[which] = place < 0 ? NaN : c1[place]
  rings.change.emit()
}
