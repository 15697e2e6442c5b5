// Saves what the server has put into the source as a file of the browser's.
export default ({source}) => {
  const [name] = source.data.name
  const [content] = source.data.content
  if (!name) return
  const link = document.createElement("a")
  link.href = URL.createObjectURL(new Blob([content], {type: "application/octet-stream"}))
  link.download = name
  link.click()
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000)
}
