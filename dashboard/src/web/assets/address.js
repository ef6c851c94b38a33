// The page's address, which names what is shown, so that a reload, the back button and a link give the same picture.

/** How long to wait for further changes, because browsers limit how often the address may change. */
const REST_MS = 300;

/**
 * Values by their names in the address; `null` or an empty text leaves a name out.
 * @typedef {Record<string, string | number | null>} Values
 */

class Address {
  /** What the address is about to be. */
  values = new URLSearchParams(location.search);
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  waits;

  /** @param {string} name */
  get(name) {
    return this.values.get(name);
  }

  /**
   * Changes values.
   * @param {Values} values
   * @param {boolean} [isNew] whether the back button returns to the values before
   */
  set(values, isNew = false) {
    const before = this.values.toString();
    if (isNew) this.write();
    for (const [name, value] of Object.entries(values)) {
      if (value === null || value === "") this.values.delete(name);
      else this.values.set(name, String(value));
    }
    if (this.values.toString() === before) return;
    if (isNew) history.pushState(null, "", this.link());
    else this.waits ||= setTimeout(() => this.write(), REST_MS);
  }

  /** Shows the values in the browser now. */
  write() {
    if (this.waits) history.replaceState(null, "", this.link());
    clearTimeout(this.waits);
    this.waits = undefined;
  }

  /** Returns the whole address, with commas that people can read. */
  link() {
    const query = this.values.toString().replaceAll("%2C", ",");
    return `${location.origin}${location.pathname}${query ? `?${query}` : ""}`;
  }

  /**
   * Calls `shown` when the user goes back or forth to other values.
   * @param {() => void} shown
   */
  follow(shown) {
    window.addEventListener("pagehide", () => this.write());
    window.addEventListener("popstate", () => {
      clearTimeout(this.waits);
      this.waits = undefined;
      this.values = new URLSearchParams(location.search);
      shown();
    });
  }
}

export const address = new Address();
