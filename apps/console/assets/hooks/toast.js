// Information goes after a while, unless the pointer or the focus is on it.
const STAY_MS = 6000;

export default {
  mounted() { this.begin(); },
  updated() { this.begin(); },
  begin() {
    clearTimeout(this.timer);
    if (this.el.dataset.kind !== "error") this.timer = setTimeout(() => this.end(), STAY_MS);
  },
  end() {
    if (this.el.matches(":hover, :focus-within")) this.begin();
    else this.pushEvent("lv:clear-flash", { key: this.el.dataset.kind });
  },
  destroyed() { clearTimeout(this.timer); },
};
