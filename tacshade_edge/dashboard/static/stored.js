// What this browser keeps between visits. A person may have blocked it, or another page damaged it: the page works without.

/** What was kept under a name, as text; null without any. */
export const stored = (name) => attempted(() => localStorage.getItem(name));

export const store = (name, value) => attempted(() => localStorage.setItem(name, value));

/** The value that the tab keeps until it is closed; null without any. */
export const storedInTab = (name) => attempted(() => JSON.parse(sessionStorage.getItem(name)));

export const storeInTab = (name, value) => attempted(() => sessionStorage.setItem(name, JSON.stringify(value)));

/** Its value; null if the store is blocked, full or damaged. */
function attempted(action) {
  try { return action(); }
  catch { return null; }
}

/** The decoded part of an address behind a mark; a stray % stays as it is. */
export function decodedPart(part) {
  try { return decodeURIComponent(part); }
  catch { return part; }
}
