/** The time line: a lane a marker, its status by colour and by shape, requests, answers, and where the picture is. */

const HEAD = 20, LANE = 22;

export class TimeLine {
  /** @param {HTMLCanvasElement} canvas @param {(frame: number, done: boolean) => void} go */
  constructor(canvas, go) {
    this.canvas = canvas;
    this.go = go;
    this.first = 0; this.last = 0;
    this.from = 0; this.to = 1; // the frames shown, as numbers with a fraction
    this.frame = 0;
    /** @type {string[]} */ this.markers = [];
    /** @type {Record<string, [number, number][]>} */ this.lanes = {};
    /** @type {any[]} */ this.requests = [];
    /** @type {any[]} */ this.answers = [];
    /** @type {{marker: string, first: number, last: number} | null} */ this.span = null;
    /** @type {{marker: string, runs: [number, number][]} | null} */ this.trial = null; // a lane of its own, below its marker's
    this.knownTo = 0;
    this.due = false;
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(e.deltaY / 300), this.frameAt(e.offsetX));
    }, { passive: false });
  }

  /** @param {number} first @param {number} last */
  of(first, last) {
    Object.assign(this, { first, last, from: first, to: Math.max(last + 1, first + 1) });
    this.draw();
  }

  /** Show more (factor > 1) or less about a frame. @param {number} factor @param {number} [about] */
  zoom(factor, about = this.frame) {
    const whole = this.last + 1 - this.first;
    const wide = Math.min(whole, Math.max(Math.min(20, whole), (this.to - this.from) * factor));
    const share = (about - this.from) / (this.to - this.from);
    this.from = Math.min(Math.max(this.first, about - share * wide), this.last + 1 - wide);
    this.to = this.from + wide;
    this.draw();
  }

  /** @param {number} frame */
  at(frame) {
    this.frame = frame;
    const wide = this.to - this.from;
    if (frame < this.from || frame >= this.to) {
      this.from = Math.min(Math.max(this.first, frame - wide / 2), this.last + 1 - wide);
      this.to = this.from + wide;
    }
    this.draw();
  }

  /** The lanes from top to bottom. @returns {{marker: string, trial: boolean}[]} */
  rows() {
    return this.markers.flatMap((marker) => [{ marker, trial: false }, ...(this.trial?.marker === marker ? [{ marker, trial: true }] : [])]);
  }

  /** @param {string} marker */
  row(marker) { return this.rows().findIndex((row) => row.marker === marker); }

  /** @param {number} x */
  frameAt(x) {
    const share = x / Math.max(1, this.canvas.clientWidth);
    return Math.min(this.last, Math.max(this.first, Math.floor(this.from + share * (this.to - this.from))));
  }

  /** @param {number} frame */
  x(frame) { return (frame - this.from) / (this.to - this.from) * this.canvas.clientWidth; }

  /** @param {PointerEvent} e */
  down(e) {
    this.canvas.setPointerCapture(e.pointerId);
    this.go(this.frameAt(e.offsetX), false);
    /** @param {PointerEvent} m */
    const move = (m) => this.go(this.frameAt(m.offsetX), false);
    /** @param {PointerEvent} m */
    const up = (m) => {
      for (const [kind, f] of /** @type {[string, any][]} */ ([["pointermove", move], ["pointerup", up], ["pointercancel", up]])) this.canvas.removeEventListener(kind, f);
      this.go(this.frameAt(m.offsetX), true);
    };
    this.canvas.addEventListener("pointermove", move);
    this.canvas.addEventListener("pointerup", up);
    this.canvas.addEventListener("pointercancel", up);
  }

  draw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => { this.due = false; this.paint(); });
  }

  paint() {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    const rows = this.rows(), height = HEAD + Math.max(1, rows.length) * LANE + 4;
    canvas.style.height = `${height}px`;
    const wide = canvas.clientWidth;
    canvas.width = Math.round(wide * ratio); canvas.height = Math.round(height * ratio);
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(canvas);
    /** @param {string} name */ const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.ruler(context, wide, colour);
    rows.forEach(({ marker, trial }, row) => this.lane(context, (trial ? this.trial?.runs : this.lanes[marker]) ?? [], HEAD + row * LANE, colour));
    for (const answer of this.answers) {
      const row = this.row(answer.marker);
      if (row < 0) continue;
      const x = this.x(answer.frame + 0.5), y = HEAD + row * LANE + LANE;
      context.fillStyle = colour("answer");
      triangle(context, x, y - 8, x - 5, y, x + 5, y);
      if (answer.kind !== "circle") context.fillRect(this.x(answer.frame), y - 3, Math.max(2, this.x(answer.to_frame + 1) - this.x(answer.frame)), 3);
    }
    for (const request of this.requests) {
      const row = this.row(request.marker);
      const x = this.x(request.first_unverified + 0.5), y = HEAD + row * LANE;
      context.fillStyle = colour(request.answered ? "OUT_OF_VIEW" : "LOST");
      triangle(context, x - 5, y - 1, x + 5, y - 1, x, y + 8);
    }
    if (this.span) {
      const row = this.row(this.span.marker);
      context.strokeStyle = colour("main"); context.lineWidth = 2;
      context.strokeRect(this.x(this.span.first), HEAD + row * LANE + 1, Math.max(3, this.x(this.span.last + 1) - this.x(this.span.first)), (this.trial ? 2 * LANE : LANE) - 2);
    }
    const x = this.x(this.frame + 0.5);
    context.fillStyle = colour("ink");
    context.fillRect(x - 1, 0, 2, height);
    triangle(context, x - 6, 0, x + 6, 0, x, 8);
  }

  /** @param {CanvasRenderingContext2D} context @param {number} wide @param {(name: string) => string} colour */
  ruler(context, wide, colour) {
    const about = (this.to - this.from) / Math.max(1, wide / 110);
    const step = Math.max(1, [1, 2, 5].map((m) => m * 10 ** Math.floor(Math.log10(Math.max(1, about)))).find((s) => s >= about) ?? 10 ** Math.ceil(Math.log10(Math.max(1, about))));
    context.font = "12px system-ui, sans-serif";
    context.fillStyle = colour("quiet");
    for (let f = Math.ceil(this.from / step) * step; f < this.to; f += step) {
      const x = this.x(f + 0.5);
      context.fillRect(Math.round(x), HEAD - 5, 1, 5);
      const text = String(f), width = context.measureText(text).width;
      context.fillText(text, Math.min(Math.max(0, x - width / 2), wide - width), HEAD - 8);
    }
  }

  /** @param {CanvasRenderingContext2D} context @param {[number, number][]} runs @param {number} y @param {(name: string) => string} colour */
  lane(context, runs, y, colour) {
    const base = y + LANE - 4;
    context.fillStyle = colour("edge");
    context.fillRect(0, base, this.canvas.clientWidth, 1);
    for (let k = 0; k < runs.length; k++) {
      const [start, code] = runs[k], end = k + 1 < runs.length ? runs[k + 1][0] : this.last + 1;
      if (!code || end <= this.from || start >= this.to) continue;
      const x = this.x(start), w = Math.max(code === 2 ? 0.5 : 2, this.x(end) - x);
      const name = ["", "SEEDED", "VERIFIED", "ESTIMATED", "LOST", "OUT_OF_VIEW"][code];
      context.fillStyle = context.strokeStyle = colour(name);
      if (code === 2) context.fillRect(x, base - 14, w, 14);
      else if (code === 1) {
        const m = x + w / 2;
        context.fillRect(x, base - 14, w, 14);
        context.beginPath(); context.moveTo(m, base - 16); context.lineTo(m + 6, base - 9); context.lineTo(m, base - 2); context.lineTo(m - 6, base - 9); context.fill();
      } else if (code === 3) {
        context.save();
        context.beginPath(); context.rect(x, base - 10, w, 10); context.clip();
        context.globalAlpha = 0.35; context.fillRect(x, base - 10, w, 10); context.globalAlpha = 1;
        context.lineWidth = 2; context.beginPath();
        for (let s = Math.max(x, 0) - 12; s < Math.min(x + w, this.canvas.clientWidth) + 12; s += 6) { context.moveTo(s, base); context.lineTo(s + 6, base - 10); }
        context.stroke(); context.restore();
        context.lineWidth = 1; context.strokeRect(x + 0.5, base - 9.5, Math.max(1, w - 1), 9);
      } else if (code === 4) for (let s = Math.max(x, -7); s < Math.min(x + w, this.canvas.clientWidth); s += 7) context.fillRect(s, base - 6, Math.min(5, x + w - s), 6);
      else for (let s = Math.max(x, -6); s < Math.min(x + w, this.canvas.clientWidth); s += 5) context.fillRect(s, base - 2, Math.min(2, x + w - s), 2);
    }
  }
}

/** @param {CanvasRenderingContext2D} context @param {number[]} xy */
function triangle(context, ...xy) {
  context.beginPath();
  context.moveTo(xy[0], xy[1]); context.lineTo(xy[2], xy[3]); context.lineTo(xy[4], xy[5]);
  context.fill();
}
