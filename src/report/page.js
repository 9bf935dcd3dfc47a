for (const svg of document.querySelectorAll("svg.panels")) {
  const [t0, t1, x0, x1] = svg.dataset.x.split(" ").map(Number);
  const make = (name, cls) => {
    const element = document.createElementNS(svg.namespaceURI, name);
    element.setAttribute("class", cls);
    svg.append(element);
    return element;
  };
  const lines = [...svg.querySelectorAll("path.series")].map((path) => {
    const [y0, y1, low, high] = path.parentNode.dataset.y.split(" ").map(Number);
    const points = [...path.getAttribute("d").matchAll(/[ML](-?[\d.]+) (-?[\d.]+)/g)].map((m) => [+m[1], +m[2]]);
    return { y0, y1, low, high, points, label: path.dataset.label, panel: path.parentNode, held: path.classList.contains("command") };
  });
  const readouts = new Map([...svg.querySelectorAll("g.panel")].map((panel) => [panel, make("text", "readout")]));
  const cursor = make("path", "cursor");
  const clear = () => { cursor.setAttribute("d", ""); readouts.forEach((text) => { text.textContent = ""; }); };
  svg.addEventListener("pointerleave", clear);
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect(), view = svg.viewBox.baseVal;
    const x = (event.clientX - box.left) * view.width / box.width;
    if (x < x0 || x > x1) return clear();
    cursor.setAttribute("d", `M${x} 0V${view.height - 40}`);
    readouts.forEach((text, panel) => {
      const values = lines.filter((line) => line.panel === panel).map((line) => {
        const near = line.held ? line.points.filter((p) => p[0] <= x).pop() || [1e9, 0]
          : line.points.reduce((a, b) => Math.abs(b[0] - x) < Math.abs(a[0] - x) ? b : a, [1e9, 0]);
        if (Math.abs(near[0] - x) > 3 && !line.held) return `${line.label} –`;
        const value = line.y0 + (near[1] - line.low) / (line.high - line.low) * (line.y1 - line.y0);
        return `${line.label} ${Number(value.toPrecision(3))}`;
      });
      const right = x > (x0 + x1) / 2;
      text.setAttribute("x", right ? x - 6 : x + 6);
      text.setAttribute("y", Number(panel.dataset.y.split(" ")[3]) + 14);
      text.setAttribute("text-anchor", right ? "end" : "start");
      text.textContent = `${(t0 + (x - x0) / (x1 - x0) * (t1 - t0)).toFixed(3)} ${svg.dataset.xUnit}: ${values.join(", ")} ${panel.dataset.unit}`;
    });
  });
}
