// Ctrl+K: a few letters lead to a vehicle, a page, or a command or parameter of the vehicle that is shown. The server finds; this shows, as text.
const PAUSE_MS = 80;

export default {
  mounted() {
    const { el } = this;
    [this.input, this.list, this.said] = ["input", "ul", "[role=status]"].map((part) => el.querySelector(part));
    this.keys = (event) => {
      if (event.key.toLowerCase() !== "k" || !(event.ctrlKey || event.metaKey) || event.altKey || event.shiftKey) return;
      event.preventDefault();
      this.open();
    };
    this.asked = () => this.open();
    window.addEventListener("keydown", this.keys);
    window.addEventListener("palette", this.asked);
    this.input.addEventListener("input", () => { clearTimeout(this.pause); this.pause = setTimeout(() => this.ask(), PAUSE_MS); });
    this.input.addEventListener("keydown", (event) => this.press(event));
    this.list.addEventListener("click", (event) => this.go(event.target.closest("[role=option]")));
    el.addEventListener("click", (event) => { if (event.target === el) el.close(); });
    this.handleEvent("palette", ({ query, items }) => { if (query === this.input.value) this.show(items); });
  },
  destroyed() {
    window.removeEventListener("keydown", this.keys);
    window.removeEventListener("palette", this.asked);
    clearTimeout(this.pause);
  },
  // In front of another dialog it would hide a question.
  open() {
    if (document.querySelector("dialog[open]")) return;
    this.input.value = "";
    this.show([]);
    this.el.showModal();
    this.ask();
  },
  ask() {
    this.pushEvent("palette", { query: this.input.value });
  },
  show(items) {
    this.list.replaceChildren(...items.map(({ label, note, to }, i) => {
      const option = Object.assign(document.createElement("li"), { id: `palette-${i}` });
      option.setAttribute("role", "option");
      option.dataset.to = to;
      option.append(Object.assign(document.createElement("span"), { textContent: label }),
        Object.assign(document.createElement("small"), { textContent: note }));
      return option;
    }));
    this.said.textContent = items.length > 0 || this.input.value === "" ? "" : "Nothing has this name.";
    this.choose(0);
  },
  choose(n) {
    const options = [...this.list.children];
    this.chosen = options.length > 0 ? (n + options.length) % options.length : 0;
    options.forEach((option, i) => option.setAttribute("aria-selected", String(i === this.chosen)));
    options[this.chosen]?.scrollIntoView({ block: "nearest" });
    if (options.length > 0) this.input.setAttribute("aria-activedescendant", options[this.chosen].id);
    else this.input.removeAttribute("aria-activedescendant");
  },
  press(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step && event.key !== "Enter") return;
    event.preventDefault();
    if (step) this.choose(this.chosen + step);
    else this.go(this.list.children[this.chosen]);
  },
  go(option) {
    if (!option) return;
    this.el.close();
    const link = Object.assign(document.createElement("a"), { href: option.dataset.to });
    Object.assign(link.dataset, { phxLink: "redirect", phxLinkState: "push" });
    this.el.append(link);
    link.click();
    link.remove();
  },
};
