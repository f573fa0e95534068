// What this browser keeps between visits. A person may have blocked it, or another page damaged it: the page works without.

/** What was kept under a name, as text; null without any. */
export function stored(name) {
  try { return localStorage.getItem(name); }
  catch { return null; }
}

export function store(name, value) {
  try { localStorage.setItem(name, value); }
  catch { /* Blocked or full: it is gone with the page. */ }
}

/** The decoded part of an address behind a mark; a stray % stays as it is. */
export function decodedPart(part) {
  try { return decodeURIComponent(part); }
  catch { return part; }
}
