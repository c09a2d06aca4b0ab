// Small pictures of what a robot sees and decides: depth images, and curves of the last seconds.

const SPAN = 12;
/** Seconds that the curves show. */
const LOSS = [1e-5, 1];
/** Ends of the loss's logarithmic axis. */
const NEAR_TO_FAR = ["#000004", "#3b0f70", "#8c2981", "#de4968", "#fe9f6d", "#fcfdbf"];
const style = getComputedStyle(document.documentElement);
const colours = {};
const colour = (name) => (colours[name] ??= style.getPropertyValue(`--${name}`).trim());
const table = colourTable();

/** The colours of depth as a CSS gradient, near to far. */
export const depthGradient = `linear-gradient(90deg, ${NEAR_TO_FAR.join(", ")})`;

function colourTable() {
  const canvas = new OffscreenCanvas(256, 1);
  const context = canvas.getContext("2d");
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

/** Loss against its threshold, P_t and who drives, over the last seconds. */
export class Curves {
  constructor(canvas) {
    this.canvas = canvas;
    this.points = [];
  }

  clear() {
    this.points = [];
  }

  /** Keep one control step: now, loss, probability, driving (a state or ""), broken. */
  add(point) {
    this.points.push(point);
    while (this.points[0].now < point.now - SPAN) this.points.shift();
  }

  draw(threshold) {
    const { canvas, points } = this;
    const scale = Math.min(devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * scale)) {
      [canvas.width, canvas.height] = [Math.round(width * scale), Math.round(height * scale)];
    }
    const context = canvas.getContext("2d");
    context.setTransform(scale, 0, 0, scale, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!points.length) return;
    const end = Math.max(points.at(-1).now, SPAN);
    const x = (now) => ((now - end + SPAN) / SPAN) * width;
    const rows = { loss: [4, height * 0.5], probability: [height * 0.56, height * 0.8] };
    this.shade(context, x, [0, height * 0.84], (p) => (p.broken ? `${colour("fault")}1f` : null));
    this.shade(context, x, [height * 0.88, height], (p) => p.driving && colour(p.driving));
    const [low, high] = LOSS.map(Math.log10);
    const share = (loss) => (Math.log10(Math.min(Math.max(loss, LOSS[0]), LOSS[1])) - low) / (high - low);
    const y = ([top, bottom], value) => bottom - value * (bottom - top);
    this.level(context, width, y(rows.loss, share(threshold)), colour("fault"));
    this.level(context, width, y(rows.probability, 0.5), colour("faint"));
    this.line(context, x, (p) => y(rows.loss, share(p.loss)), colour("loss"));
    this.line(context, x, (p) => y(rows.probability, p.probability), colour("ink"));
    context.font = "600 11px system-ui, sans-serif";
    this.text(context, "loss", 4, rows.loss[0] + 10, colour("loss"));
    this.text(context, "β", 34, y(rows.loss, share(threshold)) - 3, colour("fault"));
    this.text(context, "P", 4, rows.probability[0] + 9, colour("ink"));
    this.text(context, "drives", 4, height - 4, "#fff");
  }

  shade(context, x, [top, bottom], choose) {
    let run = null;
    for (const point of [...this.points, { now: this.points.at(-1).now }]) {
      const fill = "driving" in point ? choose(point) : null;
      if (run && run.fill !== fill) {
        if (run.fill) {
          context.fillStyle = run.fill;
          context.fillRect(x(run.now), top, x(point.now) - x(run.now), bottom - top);
        }
        run = null;
      }
      run ??= { fill, now: point.now };
    }
  }

  line(context, x, y, stroke) {
    context.beginPath();
    for (const point of this.points) if (point.driving) context.lineTo(x(point.now), y(point));
    context.strokeStyle = stroke;
    context.lineWidth = 1.6;
    context.stroke();
  }

  level(context, width, y, stroke) {
    context.setLineDash([4, 3]);
    context.beginPath();
    context.moveTo(0, y);
    context.lineTo(width, y);
    context.strokeStyle = stroke;
    context.lineWidth = 1;
    context.stroke();
    context.setLineDash([]);
  }

  text(context, words, x, y, fill) {
    context.fillStyle = fill;
    context.fillText(words, x, y);
  }
}
