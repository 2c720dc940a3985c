// A drag along an axis of time shows that part of it, in all panels that share it; so do
// plus, minus and the arrows, and 0 or a double click shows all of it again.
const POINT = /([ML])(-?[\d.]+) (-?[\d.]+)/g; // marks are drawn from theirs with steps
const between = (a, b, share) => a + share * (b - a);
function evenly(low, high, most) { // round numbers, at most so many
  const width = (high - low) / most, power = 10 ** Math.floor(Math.log10(width));
  const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= width * (1 - 1e-9));
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(9)));
}

for (const svg of document.querySelectorAll("svg.long")) {
  const sheets = [...svg.querySelectorAll("[data-axes]")].map((sheet) => ({
    ends: sheet.dataset.axes.split(" ").map(Number),
    axes: [...sheet.querySelectorAll("g.x, g.y")].map((axis) => [axis, axis.innerHTML]),
    ink: [...sheet.querySelectorAll("g[clip-path] path")].map((path) => [path, path.getAttribute("d")]),
  }));
  const [left, , right] = sheets[0].ends;
  let [start, width, from] = [0, 1, null]; // what is seen of the axis; where a drag began

  function heights({ ends: [, top, , foot, , , least], ink }, across) { // of the series that are seen
    const seen = ink.filter(([path]) => path.parentNode.dataset.keys && path.checkVisibility())
      .flatMap(([, d]) => [...d.matchAll(POINT)]).filter(([, , x]) => across(x) >= left && across(x) <= right)
      .map((point) => Number(point[3]));
    if (width === 1 || least === undefined || !seen.length) return [top, foot]; // a logarithm stays
    const [up, down] = seen.reduce(([a, b], y) => [Math.min(a, y), Math.max(b, y)], [Infinity, -Infinity]);
    const edge = Math.max((down - up) / 20, (foot - top) / 1000);
    return [up - edge, down + edge];
  }

  function rule(axis, [, top, , foot], [a, b], [c, d], flat) { // from places a to b: values c to d
    const [grid, strokes] = axis.querySelectorAll("path");
    const names = [...axis.querySelectorAll("text")].filter((text) => !flat || text.getAttribute("text-anchor") === "middle");
    const ticks = evenly(c, d, flat ? 6 : 4).map((value) => [between(a, b, (value - c) / (d - c)).toFixed(1), value]);
    grid.setAttribute("d", ticks.map(([at]) => (flat ? `M${at} ${foot}V${top}` : `M${left} ${at}H${right}`)).join(""));
    strokes.setAttribute("d", `M${left} ${foot}${flat ? `H${right}` : `V${top}`}`
      + ticks.map(([at]) => (flat ? `M${at} ${foot}v3` : `M${left} ${at}h-3`)).join(""));
    axis.append(...(names.length ? ticks : []).map(([at, value]) => {
      const name = names[0].cloneNode();
      name.textContent = String(value).replace("-", "−");
      name.setAttribute(flat ? "x" : "y", flat ? at : Number(at) + 3.6);
      return name;
    }));
    for (const name of names) name.remove();
  }

  function show(a, b) { // a part of the axis, no less than a thousandth of it
    width = Math.min(1, Math.max(1e-3, b - a));
    start = Math.min(Math.max(a, 0), 1 - width);
    const across = (x) => between(left, right, ((x - left) / (right - left) - start) / width);
    for (const sheet of sheets) {
      const [, top, , foot, low, high, least, most] = sheet.ends;
      const [up, down] = heights(sheet, across);
      const to = (y) => between(top, foot, (y - up) / (down - up));
      for (const [path, d] of sheet.ink) {
        path.setAttribute("d", width === 1 ? d : d.replace(POINT, (_, letter, x, y) => `${letter}${across(x).toFixed(1)} ${to(y).toFixed(1)}`));
      }
      const times = [start, start + width].map((share) => between(low, high, share));
      const values = [down, up].map((y) => between(most, least, (y - top) / (foot - top)));
      for (const [axis, before] of sheet.axes) {
        axis.innerHTML = before;
        if (width === 1) continue;
        if (axis.matches(".x")) rule(axis, sheet.ends, [left, right], times, true);
        else if (least !== undefined) rule(axis, sheet.ends, [foot, top], values, false);
      }
    }
    svg.classList.toggle("zoomed", width < 1);
    back.hidden = width === 1;
    hush();
  }

  const shade = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  shade.setAttribute("class", "chosen");
  shade.setAttribute("height", "100%");
  const part = (event) => { // between the pointer and where it began
    const { x, width: wide } = svg.getBoundingClientRect();
    const at = ((event.clientX - x) / wide * svg.viewBox.baseVal.width - left) / (right - left);
    return [from ?? at, at].map((share) => Math.min(1, Math.max(0, share))).sort((a, b) => a - b);
  };
  svg.addEventListener("pointerdown", (event) => {
    if (event.button || event.pointerType === "touch") return;
    [from] = part(event);
    svg.setPointerCapture(event.pointerId);
  });
  svg.addEventListener("pointermove", (event) => {
    if (from === null) return;
    const [a, b] = part(event);
    shade.setAttribute("x", between(left, right, a));
    shade.setAttribute("width", (b - a) * (right - left));
    svg.append(shade);
  });
  svg.addEventListener("pointerup", (event) => {
    if (from === null) return;
    const [a, b] = part(event);
    from = null;
    shade.remove();
    if (b - a > 0.01) show(start + a * width, start + b * width);
  });
  svg.addEventListener("dblclick", () => show(0, 1));
  svg.addEventListener("keydown", (event) => {
    const [a, b, step] = [start, start + width, width / 4];
    const to = { "+": [a + step, b - step], "=": [a + step, b - step], "-": [a - 2 * step, b + 2 * step],
      ArrowLeft: [a - step, b - step], ArrowRight: [a + step, b + step], 0: [0, 1] }[event.key];
    if (!to || event.target !== svg || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    show(...to);
  });
  const back = document.createElement("button");
  back.type = "button";
  back.hidden = true;
  back.textContent = "Show all";
  back.addEventListener("click", () => show(0, 1));
  svg.closest("figure").querySelector(".tools").prepend(back);
  svg.tabIndex = 0;
  svg.setAttribute("aria-label", `${svg.getAttribute("aria-label")}. To see a part of it: drag along the axis, or press plus, minus, the arrows and 0.`);
}
