// Where a vehicle is drawn between what is heard of it, and how it fades when nothing more is heard. Pure; times are milliseconds.
import { destination } from "../geo.js";

const GUESSED_MS = 1_000;
const FADED_MS = 30_000;
const FAINTEST = 0.45;

const SILENT = ["stale", "lost"];
// A vehicle that moves is heard of all the time; one that stands is not, because nothing of it changes.
const moves = ({ speed, course, state }) => speed > 0.5 && course != null && !SILENT.includes(state);
const age = ({ at }, now) => Math.max(0, now - at);

// On its way for at most a second, and no further.
export function shown(vehicle, now) {
  const ms = Math.min(age(vehicle, now), GUESSED_MS);
  return ms > 0 && moves(vehicle) ? destination(vehicle.position, vehicle.course, (vehicle.speed * ms) / 1000) : vehicle.position;
}

export function opacity(vehicle, now) {
  if (!moves(vehicle) && !SILENT.includes(vehicle.state)) return 1;
  return Math.max(FAINTEST, Math.min(1, 1 - (age(vehicle, now) - GUESSED_MS) / FADED_MS));
}

// When the vehicles have to be drawn again though nothing is heard: in `frame` ms while one moves by half a pixel in that time, in a
// second while one fades, never (null) otherwise. `metres`: of a pixel.
export function again(vehicles, now, metres, frame) {
  let wait = null;
  for (const vehicle of vehicles) {
    const ms = age(vehicle, now);
    if (!Number.isFinite(vehicle.at)) continue;
    if (ms < GUESSED_MS && moves(vehicle) && (vehicle.speed * frame) / 1000 > metres / 2) return frame;
    const faint = opacity(vehicle, now);
    if (faint > FAINTEST && (faint < 1 || moves(vehicle) || SILENT.includes(vehicle.state))) wait = 1_000;
  }
  return wait;
}
