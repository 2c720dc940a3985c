// Each figure as a file: as it is seen, in SVG, and its numbers as CSV.
function offer(figure, kind, make) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = kind.toUpperCase();
  const name = `${figure.id.replace("figure-", "")}.${kind}`;
  button.setAttribute("aria-label", `Save ${name}`);
  button.addEventListener("click", () => {
    const link = document.createElement("a");
    const type = { svg: "image/svg+xml", csv: "text/csv" }[kind];
    link.href = URL.createObjectURL(new Blob([make(figure)], { type }));
    link.download = name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  });
  return button;
}
const quoted = (words) => (/[",\n]/.test(words) ? `"${words.replace(/"/g, '""')}"` : words);
function csvOf(figure) {
  const lines = ["panel,series,x,y,half of its bar or band,x is,y is"];
  for (const data of figure.querySelectorAll("metadata")) {
    const { panel, x, y } = data.dataset;
    let series = "";
    for (const line of data.textContent.split("\n").filter(Boolean)) {
      if (line.startsWith("#")) series = line.slice(1);
      else lines.push(`${quoted(panel)},${quoted(series)},${line},${quoted(x)},${quoted(y)}`);
    }
  }
  return `${lines.join("\n")}\n`;
}
function svgOf(figure) { // pictures and words at their places on the page, in light colours
  const frame = figure.getBoundingClientRect(), paper = 16;
  const at = (box) => `x="${(box.x - frame.x + paper).toFixed(1)}" y="${(box.y - frame.y + paper).toFixed(1)}"`;
  const plain = document.createElement("i"); // text for XML
  const safe = (words) => { plain.textContent = words; return plain.innerHTML; };
  const parts = [...figure.querySelectorAll("svg")].map((svg) => {
    const box = svg.getBoundingClientRect(), copy = svg.cloneNode(true);
    copy.querySelectorAll(".away, .points, metadata, .chosen").forEach((part) => part.remove());
    const size = getComputedStyle(svg).fontSize;
    for (const name of ["class", "tabindex", "role", "aria-label", "aria-hidden"]) copy.removeAttribute(name);
    copy.setAttribute("font-size", size);
    copy.querySelectorAll("path:not([stroke-linecap])").forEach((path) => path.setAttribute("vector-effect", "non-scaling-stroke"));
    return new XMLSerializer().serializeToString(copy)
      .replace("<svg ", `<svg ${at(box)} width="${box.width}" height="${box.height}" `);
  });
  for (const entry of figure.querySelectorAll(".legend li:not(.off)")) {
    const box = entry.getBoundingClientRect(), sample = entry.querySelector("svg").getBoundingClientRect();
    const style = getComputedStyle(entry);
    parts.push(`<text x="${sample.right - frame.x + paper + 6}" y="${box.y + box.height / 2 - frame.y + paper + 4.5}" font-size="${style.fontSize}">${safe(entry.textContent)}</text>`);
  }
  const [wide, high] = [frame.width + 2 * paper, figure.querySelector("figcaption").getBoundingClientRect().y - frame.y + 2 * paper];
  return `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${wide} ${high}" width="${wide}" height="${high}" `
    + `font-family="DejaVu Sans, Verdana, sans-serif" style="color: #16191d; background: #ffffff" fill="currentColor">`
    + `${parts.join("\n").replace(/var\([^,]*,(#\w+)\)/g, "$1")}</svg>\n`;
}
for (const figure of document.querySelectorAll("figure[id]")) {
  const tools = document.createElement("p");
  tools.className = "tools";
  tools.append(offer(figure, "svg", svgOf), offer(figure, "csv", csvOf));
  figure.prepend(tools);
}
