/** Pictures from the server: the newest look wins, those seen last stay at hand, the next ones are fetched ahead. */

const KEPT = 48;
const AHEAD = 4;
const REST_MS = 90;

/** @typedef {{frame: number, seconds: number, image: ImageBitmap}} Picture */

export class Pictures {
  /** @param {(picture: Picture, wanted: number) => void} show @param {(error: Error) => void} fail */
  constructor(show, fail) {
    /** @type {ImageBitmap | null} */ this.seen = null; // on the screen: it has to stay
    this.show = (/** @type {Picture} */ picture, /** @type {number} */ wanted) => { this.seen = picture.image; show(picture, wanted); };
    this.fail = fail;
    this.viewer = crypto.randomUUID();
    /** @type {Map<number, Picture>} */
    this.kept = new Map();
    this.looking = new AbortController();
    this.ahead = new AbortController();
    this.resting = 0;
    this.wanted = -1;
    this.waiting = false;
  }

  /** Everything is another file's now. */
  forget() {
    for (const picture of this.kept.values()) this.drop(picture);
    this.kept.clear();
    this.wanted = -1;
  }

  /** Show a frame: at once where it is at hand. While `scrubbing` the key frame before it will do until the hand rests.
   * @param {number} frame @param {{scrubbing?: boolean, first: number, last: number}} how */
  look(frame, { scrubbing = false, first, last }) {
    const step = Math.sign(frame - this.wanted) || 1;
    this.wanted = frame;
    clearTimeout(this.resting);
    this.looking.abort();
    this.ahead.abort();
    const kept = this.kept.get(frame);
    if (kept) {
      this.waiting = false;
      this.kept.delete(frame);
      this.kept.set(frame, kept);
      this.show(kept, frame);
      this.fetchAhead(frame, step, first, last);
      return;
    }
    this.waiting = true;
    this.looking = new AbortController();
    const signal = this.looking.signal;
    if (scrubbing) {
      this.fetch(frame, false, this.viewer, signal).then((p) => p && this.show(p, frame)).catch((e) => this.said(e));
      this.resting = setTimeout(() => this.look(frame, { first, last }), REST_MS);
      return;
    }
    this.fetch(frame, true, this.viewer, signal).then((picture) => {
      if (!picture || this.wanted !== frame) return;
      this.waiting = false;
      this.show(picture, frame);
      this.fetchAhead(frame, step, first, last);
    }).catch((e) => this.said(e));
  }

  /** @param {Error} error */
  said(error) {
    if (error.name !== "AbortError") { this.waiting = false; this.fail(error); }
  }

  /** @param {number} frame @param {number} step @param {number} first @param {number} last */
  async fetchAhead(frame, step, first, last) {
    this.ahead = new AbortController();
    const signal = this.ahead.signal;
    try {
      for (let k = 1; k <= AHEAD; k++) {
        const next = frame + k * step;
        if (next >= first && next <= last && !this.kept.has(next)) await this.fetch(next, true, `${this.viewer}+`, signal);
      }
    } catch { /* it will be asked for again when it is wanted */ }
  }

  /** @param {number} frame @param {boolean} exact @param {string} viewer @param {AbortSignal} signal
   * @returns {Promise<Picture | null>} */
  async fetch(frame, exact, viewer, signal) {
    const response = await fetch(`/picture/${frame}?exact=${exact ? 1 : 0}&viewer=${viewer}`, { signal });
    if (response.status === 409) return null;
    if (!response.ok) throw new Error(await response.text());
    const shown = Number(response.headers.get("x-frame"));
    const image = await createImageBitmap(await response.blob());
    if (signal.aborted) { image.close(); return null; }
    const there = this.kept.get(shown);
    if (there) { image.close(); return there; }
    const picture = { frame: shown, seconds: Number(response.headers.get("x-seconds")), image };
    this.kept.set(shown, picture);
    for (const [old, gone] of this.kept) {
      if (this.kept.size <= KEPT) break;
      if (old !== shown && old !== this.wanted) { this.kept.delete(old); this.drop(gone); }
    }
    return picture;
  }

  /** @param {Picture} picture */
  drop(picture) { if (picture.image !== this.seen) picture.image.close(); }
}
