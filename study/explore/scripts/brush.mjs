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
const LATER_MS = 100
const FEW = 1000 // rows, whose points are larger
const SHOWN_PERCENT = [0.5, 99.5] // of the numbers of a column, in all views; zoom out to see the rest
const MARGIN = 0.02 // around all points, of the axes
let state = null

export default (args, event) => {
  state ??= begin(args)
  window.store_view = state // for tests
  if (event.geometry) {
    if (event.final) brush(args, event)
  } else if (event.event_name === "tap") {
    const place = nearest(args, event)
    if (place >= 0) pick(args, args.source.data.row[place])
  } else if (event.event_name === "mousemove" || event.event_name === "mouseleave") {
    point_at(args, event.event_name === "mousemove" ? nearest(args, event) : -1)
  } else if (event === args.row) {
    mark(args)
  } else if (event === args.table.selected) {
    const [place] = event.indices
    if (place !== undefined) pick(args, args.table.data.row[place])
  } else if (event === args.plot.x_range || event === args.plot.y_range) {
    if (!state.turning) paint(args)
  } else {
    refresh(args)
  }
}

function begin({table}) {
  // A click on the row that is selected would change no selection, and so tell nothing.
  document.addEventListener("click", (event) => {
    const in_table = event.composedPath().some((part) => part.classList?.contains("slick-row"))
    if (in_table) table.selected.setv({indices: []}, HERE)
  }, {capture: true})
  return {inside: null, ms: 0, refreshed: 0, ends: [], values: []}
}

// Lets a row walk, again if it is the one that is shown.
function pick({row}, number) {
  if (row.value === number) row.tags = [performance.now()]
  else row.value = number
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
  const take = (slot, ends) => { // a box up to the edge takes what lies beyond, too
    ends.sort((one, other) => one - other)
    const [low, high] = state.ends[slot]
    if (ends[0] <= low) ends[0] = -Infinity
    if (ends[1] >= high) ends[1] = Infinity
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
  let chosen = 0
  for (let i = 0; i < rows; i++) chosen += inside[i]
  Object.assign(state, {inside, all: chosen === rows, chosen})
  args.columns.forEach((_, slot) => { if (data[`c${slot}`] !== state.values[slot]) turn(args, slot) })
  paint(args)
  count(args)
  list(args)
  mark(args)
  state.ms = performance.now() - began
  state.refreshed += 1
}

// Words of a Div; a change that its view sees would lay out the whole page anew.
function tell(div, text) {
  div.setv({text}, {silent: true})
  const [view] = Bokeh.index.query((view) => view.model === div)
  if (view?.markup_el) view.markup_el.textContent = text
}

// Of a histogram the bars of all rows, then those of the rows inside.
function bars_of({renderers}) {
  return renderers.map(({data_source}) => data_source)
}

// All views to another column: bounds of most of its numbers, for a few outliers would press all others together.
function turn({source, plot, histograms}, slot) {
  const values = state.values[slot] = source.data[`c${slot}`]
  const finite = new Float64Array(values).filter(Number.isFinite).sort()
  const at = (percent) => finite[Math.round(percent / 100 * (finite.length - 1))]
  let [low, high] = finite.length ? SHOWN_PERCENT.map(at) : [0, 1]
  if (!(high > low)) [low, high] = [low - 0.5, low + 0.5]
  state.ends[slot] = [low, high]
  const bars = bars_of(histograms[slot])
  for (const {data: {left, right}} of bars) {
    left.forEach((_, i) => {
      left[i] = low + (high - low) * i / left.length
      right[i] = low + (high - low) * (i + 1) / left.length
    })
  }
  const [every] = bars
  tally(every.data.top, finite, state.ends[slot])
  every.change.emit()
  histograms[slot].x_range.setv({start: low, end: high}, HERE)
  if (slot === 2) plot.below.at(-1).color_mapper.setv({low, high}, HERE)
  if (slot > 1) return
  const [start, end] = [low - MARGIN * (high - low), high + MARGIN * (high - low)]
  state.turning = true // painted once, in the end
  ;[plot.x_range, plot.y_range][slot].setv({start, end, reset_start: start, reset_end: end}, HERE)
  state.turning = false
}

// How many numbers, of all or of rows inside, are in each bar; those beyond the ends are in the first and the last.
function tally(counts, values, [low, high], inside = null) {
  counts.fill(0)
  const scale = counts.length / (high - low)
  for (let i = 0; i < values.length; i++) {
    if (inside && !inside[i]) continue
    const place = Math.floor((values[i] - low) * scale)
    if (!isNaN(place)) counts[Math.max(0, Math.min(place, counts.length - 1))] += 1
  }
}

// Rows outside the selection first, pale; then those inside, coloured; marked ones last, with a rim.
function paint({source, plot, palette}) {
  const image = plot.renderers[0].data_source
  const {c0, c1, c2, marked} = source.data
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
  const [low, high] = state.ends[2]
  const scale = palette.length / (high - low)
  const colour = (i) => palette[Math.min(palette.length - 1, Math.max(0, Math.floor((c2[i] - low) * scale)))] ?? DARK
  const square = (i, reach, ink) => {
    const [x, y] = [Math.round((c0[i] - left) * across), Math.round((c1[i] - bottom) * up)]
    if (!(x >= reach && y >= reach && x < width - reach && y < height - reach)) return
    for (let v = y - reach; v <= y + reach; v++) {
      for (let at = v * width + x - reach, end = at + 2 * reach; at <= end; at++) pixels[at] = ink
    }
  }
  const reach = c0.length < FEW ? 3 : 1
  pixels.fill(0)
  if (!state.all) for (let i = 0; i < c0.length; i++) if (!state.inside[i]) square(i, reach, PALE)
  for (let i = 0; i < c0.length; i++) if (state.inside[i] && !marked[i]) square(i, reach, colour(i))
  for (let i = 0; i < c0.length; i++) {
    if (!state.inside[i] || !marked[i]) continue
    square(i, reach + 2, DARK)
    square(i, reach + 1, colour(i))
  }
  const {x, y, dw, dh} = image.data
  x[0] = left; y[0] = bottom; dw[0] = x_range.end - left; dh[0] = y_range.end - bottom
  image.change.emit()
}

function count({source, histograms}) {
  histograms.forEach((plot, slot) => {
    const [, chosen] = bars_of(plot)
    tally(chosen.data.top, source.data[`c${slot}`], state.ends[slot], state.inside)
    chosen.change.emit()
  })
}

// The table lists a part of the rows inside: those that come first by the columns that its heads sort by.
function list(args) {
  const {source, table, columns, listing, mark: word} = args
  const [view] = Bokeh.index.query((view) => view.model === listing.children[0])
  watch_heads(args, view)
  const sorted = (view?.grid?.getSortColumns() ?? []).map(({columnId, sortAsc}) => {
    const {field, name} = view.grid.getColumns()[view.grid.getColumnIndex(columnId)]
    return {field, name, up: sortAsc}
  })
  const some = first_rows(source.data, sorted)
  const data = {row: some.map((i) => source.data.row[i]), mark: some.map((i) => source.data.marked[i] ? word : "")}
  columns.forEach((_, slot) => { data[`c${slot}`] = some.map((i) => source.data[`c${slot}`][i]) })
  table.setv({data}, HERE)
  listing.children[0].view.change.emit() // a table does not see other rows if they are as many
  say_how_many(args, sorted)
}

// A click on a head lists anew. The table's own order, of the rows that it lists, is put out of action: it puts NaN first.
function watch_heads(args, view) {
  const again = () => {
    list(args)
    mark(args)
  }
  clearTimeout(state.later)
  if (!view?.grid) { // the table is not there yet
    state.later = setTimeout(again, LATER_MS)
  } else if (!view.watched) {
    view.watched = true
    view.data.sort = () => {}
    view.grid.onSort.subscribe(again)
  }
}

function say_how_many({source, count, word}, sorted) {
  const [chosen, rows] = [state.chosen, source.data.row.length]
  const words = [`${chosen.toLocaleString("en")} of ${rows.toLocaleString("en")} ${word}${rows === 1 ? "" : "s"}`]
  if (chosen > MOST_ROWS) {
    const by = sorted.map(({name, up}) => `${name.replace(/<[^>]*>/g, "")}, ${up ? "least" : "largest"} first`)
    words.push(`the table has the first ${MOST_ROWS}${by.length ? ` by ${by.join(", ")}` : ""}`)
  }
  tell(count, words.join("; "))
}

// The rows inside that come first: NaN comes last, whichever way it is sorted.
function first_rows(data, sorted) {
  const all = []
  for (let i = 0; i < state.inside.length; i++) if (state.inside[i]) all.push(i)
  const keys = sorted.map(({field, up}) => [data[field === "mark" ? "marked" : field], up ? 1 : -1])
  const order = (one, other) => {
    for (const [values, sign] of keys) {
      const [a, b] = [values[one], values[other]]
      const differ = isNaN(a) || isNaN(b) ? isNaN(a) - isNaN(b) : sign * (a - b)
      if (differ) return differ
    }
    return one - other
  }
  if (keys.length) all.sort(order)
  return all.slice(0, MOST_ROWS)
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

function point_at({source, plot, histograms, word}, place) {
  if (place === state.pointed) return
  state.pointed = place
  const number = (slot) => `${histograms[slot].title.text.text} ${shown(source.data[`c${slot}`][place])}`
  const text = place < 0 ? " " : [`${word} ${source.data.row[place]}`, number(0), number(1), number(2)].join(", ")
  plot.title.setv({text}, HERE)
  ring(plot, 1, source.data, place)
}

function shown(value) {
  return isNaN(value) ? "-" : Number(value.toPrecision(4))
}

// The row that walks: a ring in the cloud, a line in each histogram, a colour in the table.
function mark({source, plot, histograms, row, table}) {
  const place = source.data.row.indexOf(row.value)
  ring(plot, 0, source.data, place)
  const span_of = ({center}) => center.find(({type}) => type === "Span")
  histograms.forEach((each, slot) => span_of(each).setv({location: place < 0 ? null : source.data[`c${slot}`][place]}, HERE))
  const listed = table.data.row.indexOf(row.value)
  table.selected.setv({indices: listed < 0 ? [] : [listed]}, HERE)
}

function ring(plot, which, {c0, c1}, place) {
  const rings = plot.renderers[1].data_source
  const {x, y} = rings.data
  const [across, up] = place < 0 ? [NaN, NaN] : [c0[place], c1[place]]
  if (Object.is(across, x[which]) && Object.is(up, y[which])) return
  x[which] = across
  y[which] = up
  rings.change.emit()
}
