"use strict";
// Lets one look closer at the plots: zoom, pan, legend, cursor with values, a divider between two models, and each picture as
// a file. The page is complete without it: nothing here is drawn that is not in the page's own pictures or points.

function element(parent, name, attributes, text) {
  const made = document.createElementNS(parent.namespaceURI, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return parent.appendChild(made);
}

// Round values between two numbers, 1, 2 or 5 times a power of ten apart, at most `most` of them, with their labels.
function ticks(from, to, most) {
  const power = 10 ** Math.floor(Math.log10((to - from) / most));
  const count = (step) => Math.floor(to / step + 1e-7) - Math.ceil(from / step - 1e-7) + 1;
  const step = [1, 2, 5, 10, 20].map((factor) => factor * power).find((step) => count(step) <= most);
  if (!(step > 0)) return [];
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const first = Math.ceil(from / step - 1e-7);
  return Array.from({ length: count(step) }, (_, k) => (first + k) * step).map((value) => ({
    value,
    label: decimals > 6 || Math.abs(value) >= 1e6 ? value.toPrecision(8) : value.toFixed(decimals),
  }));
}

function decoded(line) {
  const bytes = Uint8Array.from(atob(line), (digit) => digit.charCodeAt(0));
  return new DataView(bytes.buffer);
}

// One picture of panels over a common axis.
class Panels {
  constructor(svg, points) {
    this.svg = svg;
    [this.first, this.last, this.left, this.right] = svg.dataset.x.split(" ").map(Number);
    [this.from, this.to] = [this.first, this.last];
    this.divider = null;
    this.panels = [...svg.querySelectorAll("g.panel")].map((node) => {
      const [low, high] = node.dataset.y.split(" ").map(Number);
      const band = node.querySelector("[data-band]");
      return {
        node, low, high, unit: node.dataset.unit, second: Number(node.dataset.second), lines: [],
        axes: node.querySelector(".axes"), band: band && band.dataset.band.split(" ").map(Number),
        bandShape: band && band.firstElementChild, readout: null,
      };
    });
    const texts = points.trim().split("\n");
    for (const panel of this.panels) {
      for (const path of panel.node.querySelectorAll("path.series")) {
        const view = decoded(texts.shift());
        const count = view.byteLength / 8;
        const at = new Float32Array(count), value = new Float32Array(count);
        for (let k = 0; k < count; k++) {
          at[k] = view.getFloat32(8 * k, true);
          value[k] = view.getFloat32(8 * k + 4, true);
        }
        const kind = ["measured", "command", "before", "after"].find((name) => path.classList.contains(name));
        panel.lines.push({ path, at, value, kind, label: path.dataset.label, hidden: false });
      }
    }
    this.region = element(svg, "rect", { class: "region" });
    this.cursor = element(svg, "path", { class: "cursor" });
    this.border = element(svg, "path", { class: "divider" });
    for (const panel of this.panels) panel.readout = element(svg, "text", { class: "readout" });
    this.instant = element(svg, "text", { class: "readout", "text-anchor": "middle" });
    const view = svg.viewBox.baseVal;
    this.foot = view.height - 40;
    this.listen();
  }

  x(at) { return this.left + (at - this.from) / (this.to - this.from) * (this.right - this.left); }
  at(x) { return this.from + (x - this.left) / (this.right - this.left) * (this.to - this.from); }

  // Index of the first point not before `at`.
  index(line, at) {
    let [low, high] = [0, line.at.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (line.at[middle] < at) low = middle + 1; else high = middle;
    }
    return low;
  }

  // What of the axis a line is drawn over: a divider leaves what was before on its left, what came after on its right.
  span(line) {
    if (this.divider === null) return [this.from, this.to];
    const border = this.at(this.divider);
    if (line.kind === "before") return [this.from, Math.min(border, this.to)];
    if (line.kind === "after") return [Math.max(border, this.from), this.to];
    return [this.from, this.to];
  }

  // Range of what is seen of a panel, with some room at both ends.
  range(panel) {
    let [low, high] = panel.band ? panel.band : [Infinity, -Infinity];
    for (const line of panel.lines.filter((line) => !line.hidden)) {
      const [from, to] = [this.index(line, this.from), this.index(line, this.to)];
      // A held value reaches into the picture from before it.
      for (let k = Math.max(from - 1, 0); k <= Math.min(to, line.at.length - 1); k++) {
        const inside = line.at[k] >= this.from && line.at[k] <= this.to;
        if (!(inside || line.kind === "command") || !Number.isFinite(line.value[k])) continue;
        low = Math.min(low, line.value[k]);
        high = Math.max(high, line.value[k]);
      }
    }
    if (low > high) return null;
    const size = Math.max(Math.abs(low), Math.abs(high));
    if (high - low <= 1e-9 * size || size === 0) {
      const pad = size > 0 ? 0.1 * size : 1;
      [low, high] = [low - pad, high + pad];
    }
    const room = 0.05 * (high - low);
    return [low - room, high + room];
  }

  // The line as a path; in each column of the screen its first, lowest, highest and last point, so that no peak is lost.
  path(line, y) {
    const [from, to] = this.span(line);
    if (line.hidden || !(from < to)) return "";
    // At an edge of the picture the line goes on; at the divider it ends.
    const before = from === this.from ? 1 : 0, beyond = to === this.to ? 1 : 0;
    const [begin, end] = [Math.max(this.index(line, from) - before, 0), Math.min(this.index(line, to) + beyond, line.at.length)];
    let [out, pen, drawn, column, here] = ["", "M", 0, null, []];
    const flush = () => {
      let [lowest, highest] = [0, 0];
      here.forEach((k, place) => {
        if (line.value[k] < line.value[here[lowest]]) lowest = place;
        if (line.value[k] > line.value[here[highest]]) highest = place;
      });
      const kept = here.length ? new Set([0, lowest, highest, here.length - 1].sort((a, b) => a - b)) : [];
      for (const place of kept) {
        out += `${pen}${this.x(line.at[here[place]]).toFixed(1)} ${y(line.value[here[place]]).toFixed(1)}`;
        [pen, drawn] = ["L", drawn + 1];
      }
      here = [];
    };
    const lift = () => {
      flush();
      if (drawn === 1) out += "h0";
      [pen, drawn] = ["M", 0];
    };
    for (let k = begin; k < end; k++) {
      if (!Number.isFinite(line.value[k])) { lift(); continue; }
      const next = Math.floor(this.x(line.at[k]));
      if (next !== column) flush();
      column = next;
      here.push(k);
    }
    lift();
    return out;
  }

  draw() {
    const across = ticks(this.from, this.to, 12);
    for (const panel of this.panels) {
      const range = this.range(panel);
      if (!range) { panel.lines.forEach((line) => line.path.setAttribute("d", "")); continue; }
      panel.range = range;
      const share = (panel.high - panel.low) / (range[1] - range[0]);
      const y = (value) => panel.low + (value - range[0]) * share;
      panel.axes.replaceChildren();
      for (const tick of across) {
        const x = this.x(tick.value);
        element(panel.axes, "path", { class: "grid", d: `M${x} ${panel.high}V${panel.low}` });
      }
      for (const tick of ticks(range[0], range[1], 6)) {
        const level = y(tick.value);
        element(panel.axes, "path", { class: tick.value === 0 ? "grid zero" : "grid", d: `M${this.left} ${level}H${this.right}` });
        element(panel.axes, "text", { class: "tick end", x: this.left - 7, y: level + 4 }, tick.label);
      }
      if (panel.second) {
        for (const tick of ticks(range[0] * panel.second, range[1] * panel.second, 6)) {
          const level = y(tick.value / panel.second);
          element(panel.axes, "path", { class: "mark", d: `M${this.right} ${level}h4` });
          element(panel.axes, "text", { class: "tick", x: this.right + 7, y: level + 4 }, tick.label);
        }
      }
      if (panel.band) {
        panel.bandShape.setAttribute("y", y(panel.band[1]));
        panel.bandShape.setAttribute("height", y(panel.band[0]) - y(panel.band[1]));
      }
      for (const line of panel.lines) line.path.setAttribute("d", this.path(line, y));
    }
    const axis = this.svg.querySelector("g.axis");
    axis.replaceChildren();
    for (const tick of across) {
      element(axis, "text", { class: "tick middle", x: this.x(tick.value), y: this.foot + 16 }, tick.label);
    }
    this.border.setAttribute("d", this.divider === null ? "" : `M${this.divider} 0V${this.foot}`);
    this.point(null);
  }

  // Shows this part of the axis, no longer than all of it and no shorter than the points can tell.
  show(from, to) {
    const whole = this.last - this.first;
    const length = Math.min(Math.max(to - from, 1e-5 * whole), whole);
    this.from = Math.min(Math.max(0.5 * (from + to - length), this.first), this.last - length);
    this.to = this.from + length;
    if (!this.waiting) {
      this.waiting = requestAnimationFrame(() => { this.waiting = 0; this.draw(); });
    }
  }

  zoom(factor, about = 0.5 * (this.from + this.to)) {
    this.show(about + (this.from - about) * factor, about + (this.to - about) * factor);
  }

  pan(share) {
    const step = share * (this.to - this.from);
    this.show(this.from + step, this.to + step);
  }

  whole() { this.show(this.first, this.last); }

  // Values at a place of the picture; of none, nothing.
  point(x) {
    const seen = x !== null && x >= this.left && x <= this.right;
    this.cursor.setAttribute("d", seen ? `M${x} 0V${this.foot}` : "");
    const digits = Math.max(0, 3 - Math.floor(Math.log10(this.to - this.from)));
    this.instant.textContent = seen ? `${this.at(x).toFixed(Math.min(digits, 7))} ${this.svg.dataset.xUnit}` : "";
    for (const [name, value] of [["x", x], ["y", this.foot + 16]]) this.instant.setAttribute(name, seen ? value : 0);
    for (const panel of this.panels) {
      if (!seen) { panel.readout.textContent = ""; continue; }
      const values = panel.lines.filter((line) => !line.hidden).map((line) => {
        const next = this.index(line, this.at(x)), held = line.kind === "command";
        const far = (k) => (k < 0 || k >= line.at.length || !Number.isFinite(line.value[k]) ? Infinity : Math.abs(this.x(line.at[k]) - x));
        const near = held ? next - 1 : far(next - 1) < far(next) ? next - 1 : next;
        // A measured value is said where there is one, not beside a gap.
        const pixels = (this.right - this.left) / 120;
        if (held ? near < 0 : far(near) > pixels) return `${line.label} –`;
        return `${line.label} ${Number(line.value[near].toPrecision(4))}`;
      });
      panel.readout.textContent = `${values.join(", ")} ${panel.unit}`;
      // On the side where there is room, and within the picture where there is room on none.
      const width = panel.readout.getComputedTextLength();
      const wanted = x > 0.5 * (this.left + this.right) ? x - 6 - width : x + 6;
      panel.readout.setAttribute("x", Math.max(this.left, Math.min(wanted, this.right - width)));
      panel.readout.setAttribute("y", panel.high + 14);
    }
  }

  listen() {
    const { svg } = this;
    const place = (event) => {
      const box = svg.getBoundingClientRect();
      return (event.clientX - box.left) * svg.viewBox.baseVal.width / box.width;
    };
    let begun = null;
    svg.addEventListener("pointerdown", (event) => {
      const x = place(event);
      if (event.button !== 0 || x < this.left || x > this.right || event.target.closest(".entry")) return;
      begun = { x, from: this.from, to: this.to, pans: event.shiftKey };
      svg.setPointerCapture(event.pointerId);
    });
    svg.addEventListener("pointermove", (event) => {
      const x = place(event);
      if (!begun) return this.point(x);
      if (begun.pans) {
        const step = (begun.x - x) / (this.right - this.left) * (begun.to - begun.from);
        return this.show(begun.from + step, begun.to + step);
      }
      const [a, b] = [begun.x, x].sort((a, b) => a - b).map((x) => Math.min(Math.max(x, this.left), this.right));
      const region = { x: a, y: 0, width: b - a, height: this.foot };
      Object.entries(region).forEach(([key, value]) => this.region.setAttribute(key, value));
      this.point(null);
    });
    const end = (event) => {
      if (begun && !begun.pans && event.type === "pointerup") {
        const [a, b] = [begun.x, place(event)].sort((a, b) => a - b);
        if (b - a > 5) this.show(this.at(Math.max(a, this.left)), this.at(Math.min(b, this.right)));
      }
      begun = null;
      this.region.setAttribute("width", 0);
    };
    svg.addEventListener("pointerup", end);
    svg.addEventListener("pointercancel", end);
    svg.addEventListener("pointerleave", () => this.point(null));
    svg.addEventListener("dblclick", () => this.whole());
    svg.addEventListener("wheel", (event) => {
      // The bare wheel scrolls the page.
      if (!(event.ctrlKey || event.metaKey)) return;
      event.preventDefault();
      this.zoom(2 ** (Math.sign(event.deltaY) / 2), this.at(place(event)));
    }, { passive: false });
    const keys = { "+": () => this.zoom(0.5), "=": () => this.zoom(0.5), "-": () => this.zoom(2), "0": () => this.whole(),
      ArrowLeft: () => this.pan(-0.25), ArrowRight: () => this.pan(0.25) };
    svg.setAttribute("tabindex", 0);
    svg.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target !== svg || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
    for (const panel of this.panels) {
      for (const entry of panel.node.querySelectorAll(".entry")) {
        const line = panel.lines[Number(entry.dataset.line)];
        const toggle = () => {
          line.hidden = !line.hidden;
          entry.classList.toggle("hidden", line.hidden);
          entry.setAttribute("aria-pressed", !line.hidden);
          this.draw();
        };
        entry.setAttribute("role", "button");
        entry.setAttribute("tabindex", 0);
        entry.setAttribute("aria-pressed", true);
        entry.addEventListener("click", toggle);
        entry.addEventListener("keydown", (event) => {
          if (event.key !== "Enter" && event.key !== " ") return;
          event.preventDefault();
          toggle();
        });
      }
    }
  }

  hasBoth() {
    const kinds = this.panels.flatMap((panel) => panel.lines.map((line) => line.kind));
    return kinds.includes("before") && kinds.includes("after");
  }
}

// The picture as a file of its own, with the page's style.
function save(svg, name) {
  const copy = svg.cloneNode(true);
  copy.querySelectorAll(".cursor, .readout, .region").forEach((node) => node.remove());
  copy.setAttribute("width", svg.viewBox.baseVal.width);
  const style = document.createElementNS(svg.namespaceURI, "style");
  style.textContent = `${document.querySelector("style").textContent}svg.plot{background:var(--paper)}`;
  copy.prepend(style);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}

document.querySelectorAll("figure").forEach((figure, index) => {
  const svg = figure.querySelector("svg.plot");
  if (!svg) return;
  const tools = document.createElement("div");
  tools.className = "tools";
  figure.prepend(tools);
  const button = (text, label, act) => {
    const made = element(tools, "button", { type: "button", title: label, "aria-label": label }, text);
    made.addEventListener("click", act);
  };
  const points = figure.querySelector("script.points");
  if (points) {
    const plot = new Panels(svg, points.textContent);
    button("+", "zoom in", () => plot.zoom(0.5));
    button("−", "zoom out", () => plot.zoom(2));
    button("◂", "earlier", () => plot.pan(-0.5));
    button("▸", "later", () => plot.pan(0.5));
    button("whole", "show the whole axis", () => plot.whole());
    if (plot.hasBoth()) {
      const label = element(tools, "label", {}, "before ");
      const slider = element(label, "input", { type: "range", min: 0, max: 1000, value: 1000, "aria-label": "divider: before on its left, after on its right" });
      label.append(" after");
      const move = () => {
        plot.divider = plot.left + slider.value / 1000 * (plot.right - plot.left);
        plot.draw();
      };
      slider.addEventListener("input", move);
      button("both", "draw both models everywhere", () => { plot.divider = null; plot.draw(); });
    }
  }
  button("SVG", "save this picture", () => save(svg, `figure-${index + 1}.svg`));
  if (points) element(tools, "span", {}, "drag to zoom, with shift to move; double click: whole; legend: hide");
});
