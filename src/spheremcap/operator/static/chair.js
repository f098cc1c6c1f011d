/** The clicks on the chair: which there are, which one is chosen, and what is done with it; every change is saved at once. */

import { get, post } from "./http.js";

/** @typedef {{on: string, frame: number, x_px: number, y_px: number, off_px?: number | null, doubted?: boolean}} Click */
/** @typedef {{count: number, said: string, rms_px: number | null, outline: number[][]}} Rim */

/** Of each thing that is clicked. @type {Record<string, string>} */
export const CHAIR_COLOURS = { left_axle: "#3fd0ff", left_rim: "#3fd0ff", right_axle: "#ff9b4a", right_rim: "#ff9b4a", front: "#8dff6b" };

/** @param {number} value A click is kept to a thousandth of a pixel. */
const rounded = (value) => Math.round(value * 1000) / 1000;
/** @param {Click | null} click */
const bare = (click) => click && { on: click.on, frame: click.frame, x_px: click.x_px, y_px: click.y_px };
/** @param {Click | null} a @param {Click | null} b */
const same = (a, b) => JSON.stringify(bare(a)) === JSON.stringify(bare(b));

export class Chair {
  /** @param {{changed: () => void, saving: () => void, saved: () => void, failed: (error: Error) => void}} say */
  constructor(say) {
    this.say = say;
    this.open = false; // whether a press on the picture clicks on the chair
    this.on = "left_axle"; // what is clicked next
    this.revision = -2;
    /** @type {Click[]} */ this.clicks = [];
    /** @type {Record<string, Rim>} */ this.rims = {};
    this.chosen = -1; // number in `clicks`
    /** @type {{was: Click | null, now: Click | null, nudge: boolean}[]} */ this.done = []; // what can be undone
    /** @type {{k: number, click: Click} | null} */ this.held = null; // in the hand, not saved
    this.waiting = 0; // changes that are not saved yet
    this.last = Promise.resolve();
  }

  /** What the server has. @param {{revision: number, clicks: Click[], rims: Record<string, Rim>}} said */
  take(said) {
    const chosen = this.clicks[this.chosen] ?? null;
    ({ revision: this.revision, clicks: this.clicks, rims: this.rims } = said);
    this.chosen = chosen ? this.clicks.findIndex((click) => same(click, chosen)) : -1;
    this.say.changed();
  }

  async fetch() {
    const said = await get("/chair");
    if (!this.waiting) this.take(said);
  }

  /** Another session is open. */
  forget() {
    this.done = []; this.held = null; this.chosen = -1; this.clicks = []; this.rims = {};
  }

  /** The clicks with the one in the hand. */
  shown() {
    const { held } = this;
    if (!held) return this.clicks;
    return held.k < 0 ? [...this.clicks, held.click] : this.clicks.map((click, k) => (k === held.k ? held.click : click));
  }

  /** The hand holds a click, or sets a new one (k = -1); `done` lets it go.
   * @param {number} k @param {number} frame @param {{x: number, y: number}} at @param {boolean} done */
  hold(k, frame, at, done) {
    const on = this.clicks[k]?.on ?? this.on;
    // Of a rim there are many, of everything else one: a new one takes its place.
    if (k < 0 && !on.endsWith("_rim")) k = this.clicks.findIndex((click) => click.on === on);
    const click = { on, frame, x_px: rounded(at.x), y_px: rounded(at.y) };
    this.held = done ? null : { k, click };
    if (!done) { this.say.changed(); return; }
    this.choose(k);
    const was = this.clicks[k] ?? null;
    if (!was || was.x_px !== click.x_px || was.y_px !== click.y_px) this.change(was, click);
  }

  /** Take hold of one, and click on its kind next. @param {number} k */
  choose(k) {
    this.chosen = k;
    if (this.clicks[k]) this.on = this.clicks[k].on;
    this.say.changed();
  }

  /** @param {number} dx @param {number} dy @param {number} frame */
  nudge(dx, dy, frame) {
    const was = this.clicks[this.chosen];
    if (was) this.change(was, { ...was, frame, x_px: rounded(was.x_px + dx), y_px: rounded(was.y_px + dy) }, true);
  }

  /** @param {number} [k] */
  remove(k = this.chosen) { if (this.clicks[k]) this.change(this.clicks[k], null); }

  undo() {
    const step = this.done.pop();
    if (step) this.send(step.now, step.was);
  }

  /** @param {Click | null} was @param {Click | null} now @param {boolean} [nudge] */
  change(was, now, nudge = false) {
    const before = this.done.at(-1);
    if (nudge && before?.nudge && same(before.now, was)) before.now = now; // one step, however many presses
    else this.done.push({ was, now, nudge });
    this.send(was, now);
  }

  /** Show a change at once, and save it behind those before it. @param {Click | null} was @param {Click | null} now */
  send(was, now) {
    const k = was ? this.clicks.findIndex((click) => same(click, was)) : this.clicks.length;
    const clicks = [...this.clicks];
    clicks.splice(k < 0 ? clicks.length : k, 1, ...(now ? [now] : []));
    this.clicks = clicks;
    this.chosen = now ? clicks.findIndex((click) => same(click, now)) : -1;
    this.waiting++;
    this.say.saving();
    this.say.changed();
    this.last = this.last.then(async () => {
      try {
        const said = await post("/click", { was: bare(was), now: bare(now) });
        if (!--this.waiting) { this.take(said); this.say.saved(); }
      } catch (error) {
        this.waiting--;
        this.done = [];
        this.say.failed(/** @type {Error} */ (error));
        await this.fetch().catch(() => {}); // it is told again when the program is back
      }
    });
  }
}
