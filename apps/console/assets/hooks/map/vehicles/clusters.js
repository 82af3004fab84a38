// Vehicles that stand so near to one another that nobody could tell their symbols apart, seen from far. Pure.

export const BELOW = 12; // zoom
const NEAR = 44; // pixels
const WORST = ["disarmed", "armed", "stale", "lost", "failsafe"];

// `vehicles`: {id, position: [lon, lat], state}; `alone(vehicle)`: whether it is never put into a cluster. Gives
// {singles: [vehicle], clusters: [{position, state, members: [vehicle]}]}. The same vehicles give the same clusters, in any order.
export function clustered(vehicles, zoom, alone) {
  const singles = [];
  const groups = [];
  // A group is its first vehicle, so that it stays where it is while others come and go.
  const scale = 512 * 2 ** Math.floor(zoom);
  for (const vehicle of [...vehicles].sort((a, b) => (a.id < b.id ? -1 : 1))) {
    if (zoom >= BELOW || alone(vehicle)) {
      singles.push(vehicle);
      continue;
    }
    const [x, y] = world(vehicle.position, scale);
    const group = groups.find((one) => Math.abs(one.x - x) < NEAR && Math.abs(one.y - y) < NEAR);
    if (group) group.members.push(vehicle);
    else groups.push({ x, y, members: [vehicle] });
  }
  for (const { members } of groups) if (members.length === 1) singles.push(members[0]);
  const clusters = groups.filter(({ members }) => members.length > 1).map(({ members }) => ({
    position: members[0].position,
    state: WORST[Math.max(...members.map(({ state }) => WORST.indexOf(state)))] ,
    members,
  }));
  return { singles, clusters };
}

function world([lon, lat], scale) {
  const sin = Math.sin((Math.max(-85, Math.min(85, lat)) * Math.PI) / 180);
  return [(lon / 360 + 0.5) * scale, (0.5 - Math.log((1 + sin) / (1 - sin)) / (4 * Math.PI)) * scale];
}
