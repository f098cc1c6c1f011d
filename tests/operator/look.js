// What the tests ask a page about itself.

const visible = (what) => [...document.querySelectorAll(what)].filter((e) => e.checkVisibility());
const hasText = (e) => [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
const brief = (e) => e.outerHTML.slice(0, 90);

/** Controls that nothing names. */
const unnamed = () => visible("button, input, select, canvas, [tabindex]")
  .filter((e) => !(e.ariaLabel || e.textContent.trim() || e.labels?.length || e.querySelector("img[alt]"))).map(brief);

/** Text that is small. */
const small = () => visible("body *").filter((e) => hasText(e) && parseFloat(getComputedStyle(e).fontSize) < 11.5).map(brief);

/** Text that does not fit where it is. */
const cut = () => visible("button, label, h2, p, dt, dd, legend")
  .filter((e) => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== "inline").map(brief);

/** Text that stands out less than WCAG's 4.5 : 1. */
const faint = () => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgb = (text) => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = text; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const linear = (v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * linear(r / 255) + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const colour = rgb(getComputedStyle(e).backgroundColor);
      if (colour[3] === 255) return colour;
    }
    return [255, 255, 255, 255];
  };
  return visible("button:enabled, p, h1, h2, span, dt, dd, label, legend, figcaption")
    .filter((e) => hasText(e) && !e.closest("#screen"))
    .map((e) => {
      const [a, b] = [light(rgb(getComputedStyle(e).color)), light(behind(e))];
      return [(Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05), brief(e)];
    }).filter(([ratio]) => ratio < 4.5);
};

/** Red, green and blue on the canvas, at a place in CSS pixels. */
const colour = (x, y) => {
  const canvas = document.getElementById("picture"), ratio = devicePixelRatio;
  return [...canvas.getContext("2d").getImageData(Math.round(x * ratio), Math.round(y * ratio), 1, 1).data].slice(0, 3);
};

/** The greatest difference between a colour's parts on the canvas around a place in CSS pixels. */
const vivid = (x, y) => {
  const canvas = document.getElementById("picture"), ratio = devicePixelRatio, side = 7;
  const data = canvas.getContext("2d").getImageData(Math.round(x * ratio) - 3, Math.round(y * ratio) - 3, side, side).data;
  let most = 0;
  for (let k = 0; k < data.length; k += 4) most = Math.max(most, Math.max(...data.slice(k, k + 3)) - Math.min(...data.slice(k, k + 3)));
  return most;
};

/** What a page of another site gets: an answer posted, the session read, a picture shown. */
const intrude = async (base) => {
  const body = JSON.stringify({ kind: "keep", marker: "wrist", frame: 40, to_frame: 49 });
  const how = { credentials: "include" };
  const post = await fetch(`${base}answer`, { method: "POST", body, mode: "no-cors", ...how }).then(() => "sent", () => "refused");
  const read = await fetch(`${base}session`, how).then(() => "read", () => "refused");
  const image = await new Promise((done) => {
    const shown = new Image();
    shown.onload = () => done("seen");
    shown.onerror = () => done("refused");
    shown.src = `${base}picture/0?exact=1`;
  });
  return [post, read, image];
};
