// Offers the columns in which all words of a text are found, and the one that is chosen.
const plain = (value) => value instanceof Map ? [...value] : Object.entries(value)

export default ({columns, options}, {value_input}) => {
  const words = value_input.toLowerCase().split(/\s+/)
  for (const select of columns) {
    const found = (group) => ([name, text]) => {
      const place = `${name} ${text} ${group}`.toLowerCase()
      return name === select.value || words.every((word) => place.includes(word))
    }
    const groups = plain(options).map(([group, pairs]) => [group, pairs.filter(found(group))])
    select.setv({options: Object.fromEntries(groups.filter(([, pairs]) => pairs.length))}, {sync: false})
  }
}
