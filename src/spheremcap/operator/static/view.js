/** The picture on its canvas: zoom to single pixels, circles and points over it, and the one that the hand moves. */

const LARGEST_SCALE = 60;
const GRIP_PX = 9;
const PIXELS_FROM = 4; // screen pixels to a picture's pixel, from which they are shown as they are, without JPEG

/** @typedef {{x: number, y: number, r: number}} Circle */
/** @typedef {{circle: Circle, colour: string, dash?: number[], width?: number, label?: string}} Drawn */
/** @typedef {{x: number, y: number, colour: string, chosen: boolean, faint: boolean, label?: string}} Point */

export class View {
  /** @param {HTMLCanvasElement} canvas
   * @param {{moved: (circle: Circle, done: boolean) => void, pointed: (k: number, at: {x: number, y: number}, done: boolean) => void, zoomed: (scale: number) => void}} on */
  constructor(canvas, on) {
    this.canvas = canvas;
    this.on = on;
    this.context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    /** @type {ImageBitmap | null} */ this.image = null;
    this.size = { width: 1, height: 1 };
    this.frame = -1;
    this.exact = false;
    this.scale = 1;
    this.left = 0; // screen position (CSS px) of the picture's top left corner
    this.top = 0;
    this.fitted = true;
    /** @type {Circle | null} */ this.circle = null;
    this.colour = "#fff";
    /** @type {Drawn[]} */ this.drawn = [];
    this.pointing = false; // a press takes hold of a point or sets one, not a circle
    /** @type {Point[]} */ this.points = [];
    /** @type {{outline: number[][], colour: string}[]} */ this.outlines = [];
    /** @type {{image: HTMLImageElement, window: number[]} | null} */ this.mask = null;
    /** @type {{image: ImageBitmap, x: number, y: number, width: number, height: number, frame: number} | null} */
    this.patch = null;
    this.patching = new AbortController();
    this.space = false;
    this.due = false;
    new ResizeObserver(() => { if (this.fitted) this.fit(); else this.draw(); }).observe(canvas);
    canvas.addEventListener("pointerdown", (e) => this.down(e));
    canvas.addEventListener("pointermove", (e) => this.hover(e));
    canvas.addEventListener("wheel", (e) => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY / 400), e.offsetX, e.offsetY); }, { passive: false });
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  }

  /** @param {number} width @param {number} height */
  of(width, height) {
    this.size = { width, height };
    this.fit();
  }

  /** @param {ImageBitmap} image @param {number} frame @param {boolean} exact */
  show(image, frame, exact) {
    this.image = image;
    this.frame = frame;
    this.exact = exact;
    this.draw();
    this.fetchPixels();
  }

  fit() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.scale = Math.max(0.01, Math.min(w / this.size.width, h / this.size.height));
    this.left = (w - this.size.width * this.scale) / 2;
    this.top = (h - this.size.height * this.scale) / 2;
    this.fitted = true;
    this.zoomed();
  }

  /** Zoom by a factor about a place on the screen, by default its middle.
   * @param {number} factor @param {number} [x] @param {number} [y] */
  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const smallest = Math.min(this.canvas.clientWidth / this.size.width, this.canvas.clientHeight / this.size.height);
    const scale = Math.min(LARGEST_SCALE, Math.max(smallest, this.scale * factor));
    if (scale <= smallest * 1.0001) { this.fit(); return; }
    this.left = x - (x - this.left) * scale / this.scale;
    this.top = y - (y - this.top) * scale / this.scale;
    this.scale = scale;
    this.fitted = false;
    this.zoomed();
  }

  /** Bring a circle to the middle, a third of the screen large. @param {Circle} circle */
  zoomTo(circle) {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    this.scale = Math.min(LARGEST_SCALE, Math.max(Math.min(w, h) / (circle.r * 6), w / this.size.width));
    this.left = w / 2 - (circle.x + 0.5) * this.scale;
    this.top = h / 2 - (circle.y + 0.5) * this.scale;
    this.fitted = false;
    this.zoomed();
  }

  zoomed() {
    this.on.zoomed(this.scale);
    this.draw();
    this.fetchPixels();
  }

  // An integer coordinate is a pixel's centre: pixel (0, 0) covers the picture's first half pixel to either side.
  /** @param {number} x */ toScreenX(x) { return this.left + (x + 0.5) * this.scale; }
  /** @param {number} y */ toScreenY(y) { return this.top + (y + 0.5) * this.scale; }
  /** @param {number} x @param {number} y */
  toPicture(x, y) { return { x: (x - this.left) / this.scale - 0.5, y: (y - this.top) / this.scale - 0.5 }; }

  /** What a press there takes hold of. @param {number} x @param {number} y @returns {"rim" | "centre" | "new"} */
  grip(x, y) {
    const c = this.circle;
    if (!c) return "new";
    const off = Math.hypot(x - this.toScreenX(c.x), y - this.toScreenY(c.y));
    const r = c.r * this.scale;
    if (Math.abs(off - r) <= GRIP_PX && off > Math.min(r / 2, r - 3)) return "rim";
    return off < r + GRIP_PX ? "centre" : "new";
  }

  /** The nearest point that a press there takes hold of, -1 for none. @param {number} x @param {number} y */
  pointAt(x, y) {
    const off = this.points.map((p) => Math.hypot(x - this.toScreenX(p.x), y - this.toScreenY(p.y)));
    const k = off.indexOf(Math.min(...off));
    return k >= 0 && off[k] <= GRIP_PX ? k : -1;
  }

  /** What of the picture is in the middle of the screen. */
  middle() { return this.toPicture(this.canvas.clientWidth / 2, this.canvas.clientHeight / 2); }

  /** @param {PointerEvent} e */
  hover(e) {
    if (e.buttons) return;
    const held = this.pointing ? (this.pointAt(e.offsetX, e.offsetY) < 0 ? "new" : "centre") : this.grip(e.offsetX, e.offsetY);
    const grip = this.space ? "pan" : held;
    this.canvas.style.cursor = { rim: "nwse-resize", centre: "move", new: "crosshair", pan: "grab" }[grip];
  }

  /** @param {PointerEvent} e */
  down(e) {
    this.canvas.focus({ preventScroll: true });
    e.preventDefault();
    const start = { x: e.offsetX, y: e.offsetY, left: this.left, top: this.top };
    const panning = this.space || e.button !== 0;
    const grip = this.grip(e.offsetX, e.offsetY);
    const pointing = this.pointing && !panning && this.exact;
    const held = pointing ? this.pointAt(e.offsetX, e.offsetY) : -1;
    const from = { ...this.points[held] };
    const before = this.circle && { ...this.circle };
    const at = this.toPicture(e.offsetX, e.offsetY);
    let place = held < 0 ? at : { x: from.x, y: from.y };
    if (pointing) this.on.pointed(held, place, false);
    /** @param {PointerEvent} m */
    const move = (m) => {
      const to = this.toPicture(m.offsetX, m.offsetY);
      if (panning) {
        this.left = start.left + m.offsetX - start.x;
        this.top = start.top + m.offsetY - start.y;
        this.fitted = false;
        this.draw();
      } else if (this.pointing) {
        if (!pointing) return;
        place = held < 0 ? to : { x: from.x + to.x - at.x, y: from.y + to.y - at.y };
        this.on.pointed(held, place, false);
      } else if (grip === "rim" && before) {
        this.circle = { ...before, r: Math.max(1, Math.hypot(to.x - before.x, to.y - before.y)) };
      } else if (grip === "centre" && before) {
        this.circle = { ...before, x: before.x + to.x - at.x, y: before.y + to.y - at.y };
      } else {
        const r = Math.hypot(to.x - at.x, to.y - at.y);
        if (r * this.scale < 3) return;
        this.circle = { x: at.x, y: at.y, r: Math.max(1, r) };
      }
      if (!panning && !this.pointing && this.circle) { this.on.moved(this.circle, false); this.draw(); }
    };
    const up = () => {
      this.canvas.removeEventListener("pointermove", move);
      this.canvas.removeEventListener("pointerup", up);
      this.canvas.removeEventListener("pointercancel", up);
      if (panning) this.fetchPixels();
      else if (this.pointing) { if (pointing) this.on.pointed(held, place, true); }
      else if (this.circle && (!before || ["x", "y", "r"].some((k) => this.circle?.[k] !== before[k]))) this.on.moved(this.circle, true);
    };
    this.canvas.setPointerCapture(e.pointerId);
    this.canvas.addEventListener("pointermove", move);
    this.canvas.addEventListener("pointerup", up);
    this.canvas.addEventListener("pointercancel", up);
  }

  /** Where single pixels can be seen, the part that shows is fetched without loss. */
  async fetchPixels() {
    this.patching.abort();
    if (this.scale < PIXELS_FROM || !this.exact) return;
    const a = this.toPicture(0, 0), b = this.toPicture(this.canvas.clientWidth, this.canvas.clientHeight);
    const x = Math.max(0, Math.floor(a.x)), y = Math.max(0, Math.floor(a.y));
    const width = Math.min(this.size.width - x, Math.ceil(b.x) - x + 1), height = Math.min(this.size.height - y, Math.ceil(b.y) - y + 1);
    if (width < 1 || height < 1) return;
    const p = this.patch;
    if (p && p.frame === this.frame && p.x <= x && p.y <= y && p.x + p.width >= x + width && p.y + p.height >= y + height) return;
    const frame = this.frame;
    this.patching = new AbortController();
    const signal = this.patching.signal;
    try {
      await new Promise((done) => setTimeout(done, 120));
      if (signal.aborted) return;
      const response = await fetch(`/patch/${frame}?x=${x}&y=${y}&width=${width}&height=${height}`, { signal });
      if (!response.ok) return;
      const image = await createImageBitmap(await response.blob());
      if (signal.aborted || frame !== this.frame) { image.close(); return; }
      this.patch?.image.close();
      this.patch = { image, x, y, width, height, frame };
      this.draw();
    } catch { /* the JPEG stays */ }
  }

  draw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => { this.due = false; this.paint(); });
  }

  paint() {
    const { canvas, context } = this, ratio = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    context.imageSmoothingEnabled = this.scale < PIXELS_FROM;
    if (this.image) context.drawImage(this.image, this.left, this.top, this.size.width * this.scale, this.size.height * this.scale);
    const p = this.patch;
    if (p && p.frame === this.frame && this.scale >= PIXELS_FROM) {
      context.drawImage(p.image, this.left + p.x * this.scale, this.top + p.y * this.scale, p.width * this.scale, p.height * this.scale);
    }
    if (this.mask?.image.complete) {
      const [x, y, width, height] = this.mask.window;
      context.imageSmoothingEnabled = false;
      context.drawImage(this.mask.image, this.left + x * this.scale, this.top + y * this.scale, width * this.scale, height * this.scale);
    }
    for (const one of this.drawn) this.ring(one);
    for (const one of this.outlines) this.outline(one);
    for (const one of this.points) this.cross(one);
    if (this.circle) {
      this.ring({ circle: this.circle, colour: this.colour, width: 2.5 });
      const x = this.toScreenX(this.circle.x), y = this.toScreenY(this.circle.y);
      for (const [colour, width] of /** @type {[string, number][]} */ ([["rgb(0 0 0 / .6)", 3], [this.colour, 1]])) {
        context.strokeStyle = colour; context.lineWidth = width; context.setLineDash([]);
        context.beginPath();
        context.moveTo(x - 6, y); context.lineTo(x + 6, y); context.moveTo(x, y - 6); context.lineTo(x, y + 6);
        context.stroke();
      }
      context.fillStyle = this.colour; context.strokeStyle = "rgb(0 0 0 / .7)"; context.lineWidth = 1;
      context.beginPath(); context.rect(x + this.circle.r * this.scale - 4, y - 4, 8, 8); context.fill(); context.stroke();
    }
  }

  /** @param {Drawn} one */
  ring({ circle, colour, dash = [], width = 2, label }) {
    const { context } = this;
    const x = this.toScreenX(circle.x), y = this.toScreenY(circle.y), r = circle.r * this.scale;
    context.beginPath();
    context.arc(x, y, Math.max(0.5, r), 0, 2 * Math.PI);
    context.setLineDash([]); context.strokeStyle = "rgb(0 0 0 / .55)"; context.lineWidth = width + 2; context.stroke();
    context.setLineDash(dash); context.strokeStyle = colour; context.lineWidth = width; context.stroke();
    context.setLineDash([]);
    if (label) this.label(label, x, y, r);
  }

  /** A text over a place on the screen, or under it where there is no room. @param {string} text @param {number} x @param {number} y @param {number} r */
  label(text, x, y, r) {
    const { context } = this;
    context.font = "600 13px system-ui, sans-serif";
    const wide = context.measureText(text).width;
    const lx = Math.min(Math.max(4, x - wide / 2), this.canvas.clientWidth - wide - 4), ly = y - r - 8 > 16 ? y - r - 8 : y + r + 18;
    context.fillStyle = "rgb(0 0 0 / .65)"; context.fillRect(lx - 4, ly - 13, wide + 8, 18);
    context.fillStyle = "#fff"; context.fillText(text, lx, ly);
  }

  /** A closed line of the picture. @param {{outline: number[][], colour: string}} one */
  outline({ outline, colour }) {
    const { context } = this;
    context.beginPath();
    for (const [x, y] of outline) context.lineTo(this.toScreenX(x), this.toScreenY(y));
    context.closePath();
    for (const [style, width] of /** @type {[string, number][]} */ ([["rgb(0 0 0 / .5)", 3], [colour, 1.2]])) {
      context.strokeStyle = style; context.lineWidth = width; context.stroke();
    }
  }

  /** A point, with its very place left open so that it can be seen. @param {Point} point */
  cross({ x: px, y: py, colour, chosen, faint, label }) {
    const { context } = this, x = this.toScreenX(px), y = this.toScreenY(py), arm = chosen ? 14 : 9;
    context.globalAlpha = faint ? 0.55 : 1;
    context.beginPath();
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { context.moveTo(x + 3 * dx, y + 3 * dy); context.lineTo(x + arm * dx, y + arm * dy); }
    if (chosen) { context.moveTo(x + 10, y); context.arc(x, y, 10, 0, 2 * Math.PI); }
    for (const [style, width] of /** @type {[string, number][]} */ ([["rgb(0 0 0 / .7)", 4], [colour, 2]])) {
      context.strokeStyle = style; context.lineWidth = width; context.stroke();
    }
    context.globalAlpha = 1;
    if (label) this.label(label, x, y, arm);
  }
}
