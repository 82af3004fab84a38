// The console's own script: connects the live page, and registers the hooks of all pages. A hook that needs a large
// package imports it when it is mounted.
import { Socket } from "./npm/phoenix/phoenix.mjs";
import { LiveSocket } from "./npm/phoenix_live_view/phoenix_live_view.esm.js";
import { watch } from "./lib/gateway.js";
import { actions } from "./lib/actions.js";
import { keyboard } from "./lib/keyboard.js";
import AlarmSound from "./hooks/alarm_sound.js";
import Chart from "./hooks/chart.js";
import CommandForm from "./hooks/command_form.js";
import Dialog from "./hooks/dialog.js";
import FleetMap from "./hooks/fleet_map.js";
import FleetTable from "./hooks/fleet_table.js";
import HoldButton from "./hooks/hold_button.js";
import Instruments from "./hooks/instruments.js";
import Palette from "./hooks/palette.js";
import ParamsFile from "./hooks/params_file.js";
import MissionFiles from "./hooks/mission_files.js";
import PlanFile from "./hooks/plan_file.js";
import Replay from "./hooks/replay.js";
import SheetOrder from "./hooks/sheet_order.js";
import Splitter from "./hooks/splitter.js";
import TimeStrip from "./hooks/time_strip.js";
import Toast from "./hooks/toast.js";

const hooks = {
  AlarmSound, Chart, CommandForm, Dialog, FleetMap, FleetTable, HoldButton, Instruments, MissionFiles, Palette, ParamsFile, PlanFile, Replay,
  SheetOrder, Splitter, TimeStrip, Toast,
};

// A gateway that starts again is back within a second; the client's own pauses grow to five.
const pause = (tries) => [50, 100, 200, 500][tries - 1] ?? 1000;
const csrf = document.querySelector("meta[name='csrf-token']").content;

// Never log at length: pages of localhost would.
sessionStorage.setItem("phx:live-socket:debug", "false");

const liveSocket = new LiveSocket("/live", Socket, {
  params: { _csrf_token: csrf },
  hooks,
  // The client loads the page again when it waits longer for an answer: no help to a gateway or a computer that is merely busy.
  timeout: 30_000,
  reconnectAfterMs: pause,
  rejoinAfterMs: pause,
});

// After a link or a key has led to another page, the keyboard goes on from its content, and not from the top of the document.
window.addEventListener("phx:page-loading-stop", ({ detail }) => {
  if (detail?.kind === "redirect" && document.activeElement === document.body) document.getElementById("main")?.focus({ preventScroll: true });
});

liveSocket.connect();
watch(liveSocket);
actions();
keyboard();
