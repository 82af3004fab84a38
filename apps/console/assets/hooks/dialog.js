// A dialog that is open while it is in the page.
export default {
  mounted() {
    this.before = document.activeElement;
    this.el.addEventListener("cancel", (event) => {
      event.preventDefault();
      this.pushEvent(this.el.dataset.cancel, {});
    });
    if (!this.el.open) this.el.showModal();
  },
  updated() {
    if (!this.el.open) this.el.showModal();
  },
  destroyed() {
    if (this.before?.isConnected) this.before.focus();
  },
};
