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
  const place = "http://www.w3.org/2000/svg", paper = 16, frame = figure.getBoundingClientRect();
  const set = (part, values) => Object.entries(values).forEach(([key, value]) => part.setAttribute(key, value));
  const at = (box) => ({ x: box.x - frame.x + paper, y: box.y - frame.y + paper, width: box.width, height: box.height });
  const [width, height] = [frame.width + 2 * paper, figure.querySelector("figcaption").getBoundingClientRect().y - frame.y + 2 * paper];
  const whole = document.createElementNS(place, "svg");
  set(whole, { viewBox: `0 0 ${width} ${height}`, width, height, "font-family": "DejaVu Sans, Verdana, sans-serif",
    fill: "currentColor", style: "color: #16191d; background: #ffffff" });
  for (const svg of figure.querySelectorAll("svg")) {
    if (svg.closest(".off")) continue;
    const copy = svg.cloneNode(true);
    for (const part of copy.querySelectorAll(".away, .points, metadata")) part.remove();
    for (const name of ["class", "tabindex", "role", "aria-label", "aria-hidden"]) copy.removeAttribute(name);
    set(copy, { ...at(svg.getBoundingClientRect()), "font-size": getComputedStyle(svg).fontSize });
    whole.append(copy);
  }
  for (const entry of figure.querySelectorAll(".legend li:not(.off)")) {
    const { x, y, height: high } = at(entry.getBoundingClientRect());
    const words = document.createElementNS(place, "text");
    set(words, { x: x + 30, y: y + high / 2 + 4.5, "font-size": getComputedStyle(entry).fontSize });
    words.textContent = entry.textContent;
    whole.append(words);
  }
  return new XMLSerializer().serializeToString(whole).replace(/var\([^,]*,\s*(#\w+)\)/g, "$1");
}
for (const line of document.querySelectorAll(".panels path:not([stroke-linecap])")) {
  line.setAttribute("vector-effect", "non-scaling-stroke"); // as wide in a large figure
}
for (const figure of document.querySelectorAll("figure[id]")) {
  const tools = document.createElement("p");
  tools.className = "tools";
  tools.append(offer(figure, "svg", svgOf), offer(figure, "csv", csvOf));
  figure.prepend(tools);
}
