// Curves over the steps of one or two episodes, on canvases that are drawn anew only when something but the time changes.
"use strict";

const LEFT = 46, RIGHT = 8, TOP = 6, BOTTOM = 18;

function element(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
}

// Return a context in CSS pixels for the size that the canvas has on the screen.
function context(canvas) {
  const { width, height } = canvas.getBoundingClientRect();
  const ratio = window.devicePixelRatio || 1;
  canvas.width = Math.max(1, Math.round(width * ratio));
  canvas.height = Math.max(1, Math.round(height * ratio));
  const pen = canvas.getContext("2d");
  pen.scale(ratio, ratio);
  return { pen, width, height };
}

// Return round numbers inside or just around a range: 3 to 7 of them.
function ticks(low, high, wanted = 4) {
  const rough = (high - low) / wanted;
  const unit = 10 ** Math.floor(Math.log10(rough));
  const step = unit * [1, 2, 2.5, 5, 10].find((factor) => unit * factor >= rough * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i++) found.push(i * step);
  const places = Math.max(0, Math.ceil(-Math.log10(step) - 1e-9) + (step / unit === 2.5 ? 1 : 0));
  return found.map((value) => [value, value.toFixed(Math.min(places, 12)).replace("-", "−")]);
}

function shortNumber(value) {
  if (value === null || value === undefined) return "–";
  const size = Math.abs(value);
  const places = size >= 1000 ? 0 : size >= 100 ? 1 : size >= 10 ? 2 : 3;
  return value.toFixed(places).replace("-", "−");
}

// Return the two ends of a scale, to a thousandth of what is between them.
function scale([low, high], unit) {
  const step = 10 ** Math.floor(Math.log10(high - low) - 2);
  const text = (value) => String(Number((Math.round(value / step) * step).toPrecision(6))).replaceAll("-", "−");
  return `${text(low)} to ${text(high)}${unit ? " " + unit : ""}`;
}

class Plot {
  // `curve` is what the catalogue says of it; `index` is its place in the data of an episode; `seek` takes a frame.
  constructor(curve, index, seek) {
    this.curve = curve;
    this.index = index;
    this.cursor = element("i", { className: "cursor" });
    this.canvas = element("canvas");
    this.area = element("div", { className: "area" }, this.canvas, this.cursor);
    const name = element("b", { textContent: curve.label + (curve.unit ? ` [${curve.unit}]` : "") });
    this.values = curve.names.map(() => element("span", { className: "value" }));
    const keys = this.values.map((text, i) => {
      const sample = element("i");
      sample.style.background = `var(--line-${i % 8})`;
      return element("span", { className: "key" }, sample, curve.names[i] && curve.names[i] + " ", text);
    });
    this.figure = element("figure", { className: "plot" }, element("figcaption", {}, name, ...keys), this.area);
    this.figure.dataset.curve = curve.label;
    const at = (event) => {
      const box = this.area.getBoundingClientRect();
      seek(Math.round(((event.clientX - box.left - LEFT) / Math.max(1, box.width - LEFT - RIGHT)) * (this.rows - 1)));
    };
    this.area.addEventListener("pointerdown", (event) => { this.area.setPointerCapture(event.pointerId); at(event); });
    this.area.addEventListener("pointermove", (event) => { if (event.buttons & 1) at(event); });
  }

  // Draw the lines of the episodes, the first one solid and the second one dashed, over `rows` steps.
  draw(episodes, rows, fps) {
    this.rows = rows;
    this.lines = episodes.map((episode) => episode.curves[this.index]);
    this.strides = episodes.map((episode) => episode.stride);
    const { pen, width, height } = context(this.canvas);
    this.inner = width - LEFT - RIGHT;
    let low = Infinity, high = -Infinity;
    for (const lines of this.lines) for (const line of lines) for (const value of line) {
      if (value === null) continue;
      if (value < low) low = value;
      if (value > high) high = value;
    }
    if (low > high) [low, high] = [0, 1];
    const margin = Math.max((high - low) * 0.06, Math.abs(high) * 1e-4, 1e-9);
    if (high - low < 2 * margin) [low, high] = [low - 0.5, high + 0.5];
    [low, high] = [low - margin, high + margin];
    const x = (row) => LEFT + (row / Math.max(1, rows - 1)) * this.inner;
    const y = (value) => TOP + ((high - value) / (high - low)) * (height - TOP - BOTTOM);
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = colour("dim");
    pen.strokeStyle = colour("rule");
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const [value, text] of ticks(low, high)) {
      pen.fillText(text, LEFT - 6, y(value));
      pen.beginPath();
      pen.moveTo(LEFT, Math.round(y(value)) + 0.5);
      pen.lineTo(width - RIGHT, Math.round(y(value)) + 0.5);
      pen.stroke();
    }
    pen.textAlign = "center";
    pen.textBaseline = "alphabetic";
    for (const [value, text] of ticks(0, Math.max(rows - 1, 1) / fps, 6)) pen.fillText(text + " s", Math.min(x(value * fps), width - 16), height - 4);
    pen.lineWidth = 1.5;
    pen.lineJoin = "round";
    this.lines.forEach((lines, episode) => {
      pen.setLineDash(episode ? [4, 3] : []);
      lines.forEach((line, i) => { pen.strokeStyle = colour("line-" + (i % 8)); stroke(pen, line, (i) => x(i * this.strides[episode]), y, line.length, this.inner); });
    });
  }

  // Move the cursor to a frame and show the values there.
  at(frame) {
    this.cursor.style.transform = `translateX(${LEFT + (frame / Math.max(1, this.rows - 1)) * this.inner}px)`;
    this.values.forEach((text, i) => {
      text.textContent = this.lines.map((lines, episode) => shortNumber(lines[i][Math.min(Math.floor(frame / this.strides[episode]), lines[i].length - 1)])).join(" / ");
    });
  }
}

// Draw one line; where several frames share a pixel, the lowest and the highest of them, so that no spike is lost.
function stroke(pen, line, x, y, rows, inner) {
  const stride = Math.max(1, Math.floor(rows / Math.max(1, inner)));
  let isDown = false;
  pen.beginPath();
  for (let row = 0; row < line.length; row += stride) {
    const part = line.slice(row, row + stride).filter((value) => value !== null);
    if (!part.length) { isDown = false; continue; }
    for (const value of stride > 1 ? [Math.min(...part), Math.max(...part)] : part) {
      if (isDown) pen.lineTo(x(row), y(value));
      else pen.moveTo(x(row), y(value));
      isDown = true;
    }
  }
  pen.stroke();
}

// Draw runs of frames as bars on a lane of the time line.
function drawLane(canvas, marks, rows) {
  const { pen, width, height } = context(canvas);
  for (const { flaw, runs } of marks) {
    pen.fillStyle = colour(flaw);
    for (const [first, last] of runs) {
      const left = (first / Math.max(1, rows - 1)) * width;
      pen.fillRect(left - 1, 0, Math.max(2.5, ((last - first) / Math.max(1, rows - 1)) * width + 1), height);
    }
  }
}
