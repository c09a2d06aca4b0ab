// Small pictures of what a robot sees and decides: depth images, and curves of the last seconds.

import uPlot from "uplot";

const SPAN = 12;
/** Seconds that the curves show. */
const EVERY = 0.1;
/** Seconds between their points. */
const ANOMALY = [0.01, 100];
/** Ends of its logarithmic axis. */
const HEIGHT = 150;
const STRIP = 7;
/** Heights of a plot, and of the strip of states in it, in pixels. */
const INK = { anomaly: "#f4a3a3", trust: "#ffffff", axis: "#aeb8c4", grid: "#ffffff1c", fault: "#e0484833" };
const NEAR_TO_FAR = ["#000004", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"];
const table = colourTable();

function colourTable() {
  const context = new OffscreenCanvas(256, 1).getContext("2d");
  const gradient = context.createLinearGradient(0, 0, 256, 0);
  NEAR_TO_FAR.forEach((stop, i) => gradient.addColorStop(i / (NEAR_TO_FAR.length - 1), stop));
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 1);
  return context.getImageData(0, 0, 256, 1).data;
}

/** Draw a depth image in [0, 1] on a canvas of its size; null leaves it grey. */
export function drawDepth(canvas, image) {
  const context = canvas.getContext("2d");
  const picture = context.createImageData(canvas.width, canvas.height);
  for (let i = 0; i < canvas.width * canvas.height; i += 1) {
    const at = 4 * Math.round(255 * Math.min(Math.max(image ? image[i] : 0.6, 0), 1));
    picture.data.set(table.subarray(at, at + 4), 4 * i);
  }
  context.putImageData(picture, 0, 0);
}

/** Anomaly against its limit, trust, and the state, over the last seconds. */
export class Curves {
  constructor(box, palette) {
    this.box = box;
    this.palette = palette;
    this.points = [];
    const axis = { stroke: INK.axis, grid: { stroke: INK.grid, width: 1 }, ticks: { show: false }, size: 34 };
    const options = {
      width: 300,
      height: HEIGHT,
      legend: { show: false },
      cursor: { show: false },
      scales: { x: { time: false }, anomaly: { distr: 3, range: ANOMALY }, trust: { range: [0, 1] } },
      axes: [
        { ...axis, size: 22 },
        { ...axis, scale: "anomaly", values: (_, ticks) => ticks.map((tick) => ([0.01, 1, 100].includes(tick) ? tick : "")) },
        { ...axis, scale: "trust", side: 1, grid: { show: false }, splits: () => [0, 0.5, 1] },
      ],
      series: [
        {},
        { scale: "anomaly", stroke: INK.anomaly, width: 1.5, points: { show: false } },
        { scale: "trust", stroke: INK.trust, width: 1.5, points: { show: false } },
      ],
      hooks: { drawClear: [(plot) => this.drawStates(plot)] },
    };
    this.plot = new uPlot(options, [[], [], []], box);
  }

  /** Keep a control step: now, anomaly (1: the limit), trust, state (or ""), broken. */
  add(point) {
    const last = this.points.at(-1);
    if (last && point.now < last.now + EVERY - 1e-9 && point.now >= last.now) return;
    if (last && point.now < last.now) this.points = [];
    this.points.push(point);
    if (this.points[0].now < point.now - SPAN) this.points.shift();
  }

  draw() {
    const { points, plot, box } = this;
    if (points.length < 2 || !box.clientWidth) return;
    if (plot.width !== box.clientWidth) plot.setSize({ width: box.clientWidth, height: HEIGHT });
    const now = points.at(-1).now;
    const anomaly = points.map((p) => p.state && Math.min(Math.max(p.anomaly, ANOMALY[0]), ANOMALY[1]));
    plot.setData([points.map((p) => p.now), anomaly.map((value) => value || null), points.map((p) => p.trust)], false);
    plot.setScale("x", { min: Math.max(now - SPAN, 0), max: Math.max(now, SPAN) });
  }

  /** The limit, when the camera was broken, and below, the states. */
  drawStates({ ctx, bbox, valToPos }) {
    const x = (now) => valToPos(now, "x", true);
    this.points.slice(1).forEach((point, i) => {
      const [from, to] = [x(this.points[i].now), x(point.now)];
      if (point.broken) fill(ctx, INK.fault, from, bbox.top, to, bbox.top + bbox.height);
      const { colour } = this.palette[point.state] ?? {};
      const strip = bbox.top + bbox.height - STRIP * devicePixelRatio;
      if (colour) fill(ctx, colour, from, strip, to + 1, bbox.top + bbox.height);
    });
    const limit = valToPos(1, "anomaly", true);
    fill(ctx, INK.anomaly, bbox.left, limit, bbox.left + bbox.width, limit + 1);
  }
}

function fill(context, colour, left, top, right, bottom) {
  context.fillStyle = colour;
  context.fillRect(left, top, right - left, bottom - top);
}
