// How wide the explorer's page is, whether none of its panels overlap, and whether the first are level.
() => {
    const [boxes, views] = [
        [...document.querySelectorAll("details")],
        [...Bokeh.index.query((view) => view.model.sizing_mode !== undefined)].map(({el}) => el),
    ].map((all) => all.map((one) => one.getBoundingClientRect()))
    const [low, high] = [(a, b) => a.right <= b.left, (a, b) => a.bottom <= b.top]
    const apart = (a, b) => low(a, b) || low(b, a) || high(a, b) || high(b, a)
    const wide = Math.max(document.documentElement.scrollWidth, ...views.map(({right}) => right))
    const whole = boxes.every((one, i) => boxes.slice(i + 1).every((other) => apart(one, other)))
    return [wide, whole, boxes[0].top === boxes[2].top]
}