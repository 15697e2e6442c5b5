// Draws the frames of one or two walks. While `play` is on, time goes on with the clock.
// What is drawn stays in this tab: nothing of it is sent back to the server.

const HERE = {sync: false}
const SLIDER_MS = 200 // between moves of the slider
const HIGH_M = 2.2 // shown at least, with the ground below
const AHEAD = 0.45 // where the walker is in the picture, from the left
const OWN_KEYS = /^(INPUT|SELECT|TEXTAREA|BUTTON|SUMMARY)$/ // to which the space bar means something
let state = null

export default (args, changed) => {
  state ??= begin(args)
  if (changed === args.slider) {
    if (!state.own) state.time = args.slider.value
  } else if (changed.event_name === "tap") {
    move_to(args, Math.max(0, Math.min(changed.x, args.slider.end)))
  } else if (changed !== args.play && changed !== args.ghost) { // the page is ready, or frames have come
    const ends = args.stages.map(({frames}) => frames.data.time_s?.[0].at(-1) ?? 0)
    args.slider.setv({end: Math.max(0.1, ...ends)}, HERE)
    args.timeline.setv({end: 1.02 * Math.max(0.1, ...ends)}, HERE)
    args.stages.forEach((stage, which) => line_of(stage.frames.data, args.curves[which], args.falls[which]))
    if (changed !== args.stages[1].frames) state.time = 0
    if (ends[0] > 0 || changed.data) state.shown += 1
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
}

// A walk on the time line: the height of its hip, and its fall.
function line_of({time_s, height_m, fell}, curve, fall) {
  const [x, y] = [Array.from(time_s?.[0] ?? []), Array.from(height_m?.[0] ?? [])]
  curve.setv({data: {x, y}}, HERE)
  const end = fell?.[0][0] ? -1 : x.length
  fall.setv({data: {x: x.slice(end), y: y.slice(end), words: x.slice(end).map((time) => `fell at ${time.toFixed(1)} s`)}}, HERE)
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
  pose(lines, head, all, n, px, [0, 0], args.levels)
  const hips = all.trunk[0]
  trail.data.x = Float32Array.from({length: n + 1}, (_, at) => hips[4 * at])
  trail.data.y = Float32Array.from({length: n + 1}, (_, at) => hips[4 * at + 1])
  trail.change.emit()
  const [x, z] = camera(all, n)
  const [width, height] = [inner(figure, "inner_width", 600) / px, inner(figure, "inner_height", 300) / px]
  figure.x_range.setv({start: x - AHEAD * width, end: x + (1 - AHEAD) * width}, HERE)
  figure.y_range.setv({start: z - args.below_m, end: z - args.below_m + height}, HERE)
  const last = n === all.time_s[0].length - 1 ? "   end" : ""
  figure.title.setv({text: `${all.time_s[0][n].toFixed(2)} s   ${x.toFixed(2)} m${last}`}, HERE)
}

// Lines are given by the name of their frames and their first point there.
function pose(lines, head, all, n, px, shift, levels) {
  const {xs, ys, key, first, metres, width, colour, muscle} = lines.data
  const frames = all.time_s[0].length
  const muscles = all.activation[0].length / frames
  key.forEach((name, i) => {
    const points = all[name][0]
    put(xs[i], ys[i], points, n * (points.length / frames) + 2 * first[i], shift)
    width[i] = Math.max(1, metres[i] * px)
    if (muscle[i] >= 0) colour[i] = levels[all.activation[0][n * muscles + muscle[i]]]
  })
  put(head.data.x, head.data.y, all.head[0], 2 * n, shift)
  lines.change.emit()
  head.change.emit()
}

function put(x, y, points, first, [right, up]) {
  for (let i = 0; i < x.length; i++) {
    x[i] = points[first + 2 * i] + right
    y[i] = points[first + 2 * i + 1] + up
  }
}
