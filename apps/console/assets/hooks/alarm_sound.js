// The sound of alarms: two tones for a critical one, one for a warning, again and again until somebody has seen it. Made by the browser, no
// file. Off at first, because browsers are silent until somebody has clicked; the choice is kept.
const KEY = "aerie-alarm-sound";
const AGAIN_MS = { critical: 2000, warning: 6000 };
let context;

const on = () => localStorage.getItem(KEY) === "on";

function tone(at, hertz) {
  const oscillator = context.createOscillator();
  const gain = context.createGain();
  oscillator.frequency.value = hertz;
  gain.gain.setValueAtTime(0.0001, at);
  gain.gain.exponentialRampToValueAtTime(0.25, at + 0.02);
  gain.gain.exponentialRampToValueAtTime(0.0001, at + 0.28);
  oscillator.connect(gain).connect(context.destination);
  oscillator.start(at);
  oscillator.stop(at + 0.3);
}

function play(severity) {
  context ??= new AudioContext();
  context.resume();
  tone(context.currentTime, 880);
  if (severity === "critical") tone(context.currentTime + 0.32, 660);
}

export default {
  mounted() {
    this.button = this.el.querySelector("[data-action=sound]");
    this.click = () => {
      localStorage.setItem(KEY, on() ? "off" : "on");
      if (on()) play("warning");
      this.show();
    };
    this.button.addEventListener("click", this.click);
    this.gateway = ({ detail }) => { this.lost = detail.lost; this.show(); };
    window.addEventListener("gateway", this.gateway);
    this.show();
  },
  updated() { this.show(); },
  destroyed() {
    clearInterval(this.timer);
    window.removeEventListener("gateway", this.gateway);
  },
  show() {
    this.button.setAttribute("aria-pressed", String(on()));
    const severity = on() ? (this.lost ? "critical" : this.el.dataset.sound) : undefined;
    if (severity === this.playing) return;
    this.playing = severity;
    clearInterval(this.timer);
    if (!severity) return;
    play(severity);
    this.timer = setInterval(() => play(severity), AGAIN_MS[severity]);
  },
};
