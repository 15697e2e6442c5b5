// What tests ask of a page of Bokeh's; it is there before the page's own scripts.
window.named = (name) => Bokeh.documents[0].get_model_by_name(name)
window.view_of = (name) => [...Bokeh.index.query((view) => view.model.name === name)][0]

// Where the axes of a figure are on the screen: left, top, width and height, pixels.
window.axes_of = (name) => {
    const view = view_of(name), inner = view.frame.bbox
    const canvas = view.canvas_view.el.getBoundingClientRect()
    return [canvas.x + inner.left, canvas.y + inner.top, inner.width, inner.height]
}

// Where on the screen a figure has these coordinates.
window.place_of = ([name, x, y]) => {
    const [left, top, width, height] = axes_of(name), {x_range, y_range} = named(name)
    const share = (value, {start, end}) => (value - start) / (end - start)
    return [left + share(x, x_range) * width, top + (1 - share(y, y_range)) * height]
}

// The five columns of a row of the explorer, and where it is in the cloud.
window.columns_of = (row) => {
    const {data} = named("rows"), place = data.row.indexOf(row)
    return [0, 1, 2, 3, 4].map((slot) => data[`c${slot}`][place])
}
window.point_of = (row) => place_of(["cloud", ...columns_of(row)])

// Frames of the explorer's stage that have been shown, with that which is shown now.
window.frames_shown = () => {
    const now = window.walk_player.time
    return named("stage-frames").data.time_s[0].filter((time) => time <= now + 1e-6).length
}

// Resolves when what was set before has been painted: the browser finds marks where they are painted.
window.painted = () =>
    new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))

// Hip, knee, ankle, heel and ball of a leg as it is shown now, x and z each, metres.
window.bones_of = (leg) => {
    const end = 10 * frames_shown()
    return [...named("stage-frames").data[leg][0].slice(end - 10, end)]
}

// Lines of these colours that the explorer's stage shows: the frames that they are of, and x and z of each point, metres.
window.drawn_in = (colours) => {
    const {xs, ys, key, line_color: colour} = named("stage").renderers.at(-1).data_source.data
    const points = key.map((_, i) => [...xs[i]].flatMap((x, at) => [x, ys[i][at]]))
    return key.map((name, i) => [name, points[i]])
        .filter(([, line], i) => colours.includes(colour[i]) && line.every(isFinite))
}

// Show a moment of a walk that is stopped: a frame that was under way may set another first.
window.stopped_at = (moment_s) => {
    if (window.walk_player.time === moment_s) return true
    named("time").value = 0
    named("time").value = moment_s
    return false
}
