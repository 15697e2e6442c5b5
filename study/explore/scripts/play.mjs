// Draws the frames of one or two walks. While `play` is on, time goes on with the clock.
// What is drawn stays in this tab: nothing of it is sent back to the server.

const HERE = {sync: false}
const SLIDER_MS = 200 // between moves of the slider
const HIGH_M = 2.2 // shown at least, with the ground below
const AHEAD = 0.45 // where the walker is in the picture, from the left
const CURVES = /^(cycle-|signals-)/ // begins the names of figures over time or the stride
const OVER_TIME = "over time" // tags a figure
const BONES = [0, 1, 3] // at which points of a leg's chain thigh, shank and foot begin
const [SHANK, FOOT, PYLON] = [1, 2, 3] // of the bones, and what a prosthesis has below the middle of the shank
const EARLY = 0.3 // share of the time line
const NEAR_M = 0.05 // of a muscle, from the pointer
const TOUCHED = "(hover: none)" // a finger leaves at once what it has tapped
const OWN_KEYS = /^(INPUT|SELECT|TEXTAREA|BUTTON|SUMMARY)$/ // to which the space bar means something
let state = null

export default (given, changed) => {
  const args = {...given, stages: given.stages.map(with_parts), cursor: given.timeline.center.find(({type}) => type === "Span")}
  state ??= begin(args)
  const pointed = args.stages.find(({figure}) => figure === changed.origin)
  if (changed === args.slider) {
    if (!state.own) state.time = args.slider.value
  } else if (pointed) {
    const {x_range, y_range} = pointed.figure // from their corner: they go with the walker
    const place = changed.event_name === "mouseleave" ? [] : [changed.x - x_range.start, changed.y - y_range.start]
    if (place.length || !matchMedia(TOUCHED).matches) pointed.figure.setv({tags: place}, HERE)
  } else if (changed.event_name === "tap") {
    if (changed.origin.tags[0] === OVER_TIME) move_to(args, Math.max(0, Math.min(changed.x, args.slider.end)))
  } else if (changed !== args.play && changed !== args.ghost) { // the page is ready, or frames have come
    const ends = args.stages.map(({frames}) => frames.data.time_s?.[0].at(-1) ?? 0)
    args.slider.setv({end: Math.max(0.1, ...ends)}, HERE)
    args.timeline.x_range.setv({end: 1.02 * Math.max(0.1, ...ends)}, HERE)
    args.stages.forEach((stage, which) => line_of(stage.frames.data, args.timeline.renderers.slice(3 * which), args.slider.end))
    if (changed !== args.stages[1].frames) move_to(args, 0)
    if (ends[0] > 0 || changed.data) state.shown += 1
  }
  draw_all(args)
}

// A stage, and what is moved on it: it comes after the ground.
function with_parts(stage) {
  const [, , trail, ghost_head, ghost_lines, head, lines] = stage.figure.renderers.map(({data_source}) => data_source)
  return {...stage, trail, ghost_head, ghost_lines, head, lines}
}

function begin(args) {
  const own = {time: 0, before: performance.now(), moved: 0, own: false, shown: 0}
  window.walk_player = own // for tests
  for (const {lines, ghost_lines} of args.stages) {
    lines.data = lines_of(args.looks, false)
    ghost_lines.data = lines_of(args.looks, true)
  }
  const tick = (now) => {
    const passed = (now - own.before) / 1000
    own.before = now
    if (args.play.active && args.stages[0].frames.data.time_s?.length) {
      own.time += passed * Number(args.speed.value.replace("x", ""))
      if (own.time > args.slider.end) own.time = 0
      draw_all(args)
      if (now - own.moved > SLIDER_MS) {
        own.moved = now
        move_to(args, own.time)
      }
    }
    requestAnimationFrame(tick)
  }
  requestAnimationFrame(tick)
  document.addEventListener("keydown", (event) => {
    const [focus] = event.composedPath()
    if (event.code !== "Space" || OWN_KEYS.test(focus.tagName) || focus.getAttribute?.("role")) return
    event.preventDefault()
    args.play.active = !args.play.active
  })
  return own
}

function move_to(args, time) {
  state.time = time
  state.own = true
  args.slider.setv({value: time}, HERE)
  state.own = false
}

function draw_all(args) {
  const [own, other] = args.stages
  for (const stage of args.stages) if (stage.frames.data.time_s?.length) draw(args, stage)
  if (other.figure.visible === args.ghost.active) { // of a ghost's stage, only the words are shown
    other.figure.setv({visible: !args.ghost.active}, HERE)
    other.layout.setv({styles: {flex: `1 1 ${args.ghost.active ? "100%" : args.least}`}}, HERE)
  }
  const haunted = args.ghost.active && other.frames.data.time_s?.length && own.frames.data.time_s?.length
  const at = [own, other].map(({frames}) => frames.data.time_s?.length ? frame(frames.data) : 0)
  if (haunted) { // over the walker: its hip there, at the ground's height there
    const [here, there] = [own, other].map(({frames}, which) => camera(frames.data, at[which]))
    pose(own.ghost_lines, own.ghost_head, other.frames.data, at[1], scale(args, own), [here[0] - there[0], here[1] - there[1]])
  } else if (state.haunted) {
    for (const line of [...own.ghost_lines.data.xs, own.ghost_head.data.x]) line.fill(NaN)
    own.ghost_lines.change.emit()
    own.ghost_head.change.emit()
  }
  state.haunted = haunted
  args.cursor.setv({location: state.time}, HERE)
  draw_strides(args)
}

// A line in each figure of the stride, where the left leg is between two strikes of its heel, and of
// time: an element of the page, for a cursor of Bokeh's would have each figure painted anew.
function draw_strides({stages: [{frames}], cursor}) {
  const now = performance.now()
  if (!(now - state.looked < SLIDER_MS)) {
    state.looked = now
    const curves = ({model}) => model.type === "Figure" && CURVES.test(model.name)
    state.lines = [...Bokeh.index.query(curves)].map((view) => {
      view.walker ??= view.canvas_view.overlays_el.appendChild(document.createElement("div"))
      const {left, top, width, height} = view.frame.bbox
      const place = `left: ${left - 1}px; top: ${top}px; height: ${height}px; background: ${cursor.line_color}`
      return [view.walker, width, view.model, `position: absolute; width: 2px; pointer-events: none; ${place}; transform: `]
    })
  }
  const strikes = frames.data.strikes_s?.[0] ?? []
  const next = strikes.findIndex((strike) => strike > state.time)
  state.stride = next > 0 ? 100 * (state.time - strikes[next - 1]) / (strikes[next] - strikes[next - 1]) : null
  for (const [line, px, {tags: [over], x_range: {start, end}}, style] of state.lines) {
    const share = ((over === OVER_TIME ? state.time : state.stride ?? NaN) - start) / (end - start)
    line.style = style + (share >= 0 && share <= 1 ? `translateX(${(share * px).toFixed(1)}px)` : "scale(0)")
  }
}

// A walk on the time line: the height of its hip, and its fall.
function line_of({time_s, height_m, ended}, [{data_source: curve}, {data_source: fall}], last) {
  const [x, y] = [Array.from(time_s?.[0] ?? []), Array.from(height_m?.[0] ?? [])]
  curve.setv({data: {x, y}}, HERE)
  const words = [...ended?.[0].match(/^fell after [\d.]+ s/) ?? []] // as the story: one, or none
  const end = x.length - words.length
  const fell_at = x.slice(end)
  const early = (time) => time < EARLY * last // whose words would begin before the axes
  const [align, offset] = [["left", "right"], [12, -12]].map((both) => fell_at.map((time) => both[early(time) ? 0 : 1]))
  fall.setv({data: {x: fell_at, y: y.slice(end), words, align, offset}}, HERE)
}

// The number of the frame that is shown now.
function frame({time_s: [times]}) {
  let n = times.length - 1
  while (n > 0 && times[n] > state.time + 1e-6) n -= 1
  return n
}

function camera({camera_m: [points]}, n) {
  return [points[2 * n], points[2 * n + 1]]
}

// Pixels of a metre: the view is as wide as in films, or wider where a walker would not fit.
function scale({view_m}, {figure}) {
  return Math.min(inner(figure, "inner_width", 600) / view_m, inner(figure, "inner_height", 300) / HIGH_M)
}

// The size of a figure within its axes; what it is before the figure has been laid out.
function inner(figure, name, before) {
  return figure.properties[name].is_unset ? before : figure[name] || before
}

function draw(args, {frames, lines, head, trail, figure}) {
  const all = frames.data
  const n = frame(all)
  const px = scale(args, {figure})
  pose(lines, head, all, n, px, [0, 0], args.looks)
  const hips = all.trunk[0]
  trail.data.x = Float32Array.from({length: n + 1}, (_, at) => hips[4 * at])
  trail.data.y = Float32Array.from({length: n + 1}, (_, at) => hips[4 * at + 1])
  trail.change.emit()
  const [x, z] = camera(all, n)
  const [width, height] = [inner(figure, "inner_width", 600) / px, inner(figure, "inner_height", 300) / px]
  figure.x_range.setv({start: x - AHEAD * width, end: x + (1 - AHEAD) * width}, HERE)
  figure.y_range.setv({start: z - args.below_m, end: z - args.below_m + height}, HERE)
  const last = n === all.time_s[0].length - 1 ? "   end" : ""
  const [slips, lasts] = all.slip[0]
  const slides = all.time_s[0][n] >= slips && all.time_s[0][n] < slips + lasts ? "   slippery" : ""
  const [right, up] = figure.tags
  const muscle = muscle_at(args.looks, lines.data, all, n, figure.x_range.start + right, figure.y_range.start + up)
  figure.title.setv({text: `${all.time_s[0][n].toFixed(2)} s   ${x.toFixed(2)} m${slides}${last}${muscle}`}, HERE)
}

// In words, the muscle under the pointer and its activation.
function muscle_at({muscles}, {xs, ys, muscle}, {activation: [levels]}, n, x, z) {
  let [found, least] = [-1, NEAR_M]
  muscle.forEach((number, i) => xs[i].forEach((at, k) => {
    const away = Math.hypot(at - x, ys[i][k] - z)
    if (number >= 0 && away < least) [found, least] = [number, away]
  }))
  if (found < 0) return ""
  const side = found < muscles.length ? "left" : "right"
  const level = levels[2 * muscles.length * n + found] / 255
  return `   ${side} ${muscles[found % muscles.length][0]}: ${level.toFixed(2)}`
}

// The lines of a walker, from the back to the front: the name of their frames, their first point
// there, their width in metres, the number of their muscle, -1 of others, and the leg and the bone
// that a prosthesis changes. A ghost has one colour and no forces.
function lines_of(looks, ghost) {
  const lines = []
  for (const [side, key] of [[1, "far"], [0, "near"]]) {
    if (side === 0) lines.push(["trunk", 0, 2, looks.trunk, looks.near, -1])
    looks.bones.forEach((width, i) => lines.push([key, BONES[i], 2, width, looks[key], -1, side, i]))
    lines.push([key, BONES[SHANK], 2, looks.pylon, looks.device, -1, side, PYLON])
    looks.muscles.forEach(([, belly], i) => {
      const number = looks.muscles.length * side + i
      const path = ["muscles", number * looks.points, looks.points]
      lines.push([...path, belly + looks.rim, looks.ink, -1], [...path, belly, looks.levels[0], number])
    })
    for (let i = 6 * side; i < 6 * side + 6; i++) lines.push(["struts", 4 * i, 4, looks.strut, looks.device, -1])
    for (let i = 3 * side; i < 3 * side + 3; i++) lines.push(["arrows", looks.turn * i, looks.turn, looks.arc, looks.torque, -1])
  }
  if (!ghost) looks.arrows.forEach((colour, i) => lines.push(["forces", 2 * i, 2, looks.force, colour, -1]))
  const [key, first, counts, metres, colour, muscle, leg, bone] = [...Array(8)].map((_, i) => lines.map((line) => line[i] ?? -1))
  const [xs, ys] = [0, 1].map(() => counts.map((count) => new Float32Array(count).fill(NaN)))
  const whole = {xs, ys, key, first, metres, line_width: metres.map(() => 1), line_color: colour, muscle, leg, bone}
  return ghost ? {...whole, line_color: colour.fill(looks.ghost), muscle: muscle.fill(-1)} : whole
}

// Lines are given by the name of their frames and their first point there.
function pose(lines, head, all, n, px, shift, looks) {
  const {xs, ys, key, first, metres, line_width: width, line_color: colour, muscle, leg, bone} = lines.data
  const frames = all.time_s[0].length
  const muscles = all.activation[0].length / frames
  key.forEach((name, i) => {
    const points = all[name]?.[0] ?? [] // without a device there are no lines of it
    put(xs[i], ys[i], points, n * (points.length / frames) + 2 * first[i], shift)
    width[i] = Math.max(1, metres[i] * px)
    if (looks && muscle[i] >= 0) colour[i] = looks.levels[all.activation[0][n * muscles + muscle[i]]]
    const passive = all.prosthesis[0][leg[i]]
    if (looks && bone[i] === FOOT) colour[i] = passive ? looks.device : looks[name]
    if (bone[i] === SHANK && passive) halve(xs[i], ys[i], 1)
    if (bone[i] === PYLON) halve(xs[i], ys[i], 0, passive ? 0.5 : NaN)
  })
  put(head.data.x, head.data.y, all.head[0], 2 * n, shift)
  lines.change.emit()
  head.change.emit()
}

// Puts an end of a line into its middle; or takes the line away.
function halve(x, y, end, share = 0.5) {
  for (const at of [x, y]) at[end] = share * (at[0] + at[1])
}

function put(x, y, points, first, [right, up]) {
  for (let i = 0; i < x.length; i++) {
    x[i] = points[first + 2 * i] + right
    y[i] = points[first + 2 * i + 1] + up
  }
}
