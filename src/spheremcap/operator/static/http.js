/** What the server says, as JSON; what it refuses, as an Error with its words. */

/** @param {string} path @param {AbortSignal} [signal] */
export async function get(path, signal) {
  return read(await fetch(path, { signal }));
}

/** @param {string} path @param {unknown} [body] */
export async function post(path, body) {
  return read(await fetch(path, { method: "POST", body: body === undefined ? undefined : JSON.stringify(body) }));
}

/** @param {string} path @param {Blob} file */
export async function send(path, file) {
  return read(await fetch(path, { method: "POST", body: file }));
}

/** @param {Response} response */
async function read(response) {
  if (!response.ok) throw new Error(await response.text() || `the server answered ${response.status}`);
  return response.json();
}
