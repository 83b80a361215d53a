// Elements without markup in strings: every text is a text node, so nothing that is told can be markup.

export const $ = (id) => document.getElementById(id);

/** An element with properties (`class`, `dataset`, `on*` handlers or attributes) and children (elements or texts). */
export function el(name, properties = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(properties)) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key === "class") made.className = value;
    else if (key === "dataset") Object.assign(made.dataset, value);
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== ""));
  return made;
}

/** Sets a text only where it is another: a screen reader is told of changes alone. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Calls `draw` with what is given only where that is another than the last time. */
export function onChange(draw) {
  let last;
  return (...given) => {
    const key = JSON.stringify(given);
    if (key !== last) {
      last = key;
      draw(...given);
    }
  };
}
