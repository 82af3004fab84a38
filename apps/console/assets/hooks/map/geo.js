// Geometry on the sphere, in degrees and metres. Positions are [lon, lat], as in GeoJSON.

const RADIUS = 6371008.8;
const rad = (degrees) => (degrees * Math.PI) / 180;
const deg = (radians) => (radians * 180) / Math.PI;

export function distance([lon1, lat1], [lon2, lat2]) {
  const dLat = rad(lat2 - lat1);
  const dLon = rad(lon2 - lon1);
  const a = Math.sin(dLat / 2) ** 2 + Math.cos(rad(lat1)) * Math.cos(rad(lat2)) * Math.sin(dLon / 2) ** 2;
  return 2 * RADIUS * Math.asin(Math.min(1, Math.sqrt(a)));
}

// 0..360 from north.
export function bearing([lon1, lat1], [lon2, lat2]) {
  const dLon = rad(lon2 - lon1);
  const y = Math.sin(dLon) * Math.cos(rad(lat2));
  const x = Math.cos(rad(lat1)) * Math.sin(rad(lat2)) - Math.sin(rad(lat1)) * Math.cos(rad(lat2)) * Math.cos(dLon);
  return (deg(Math.atan2(y, x)) + 360) % 360;
}

// The place `metres` away in a direction.
export function destination([lon, lat], direction, metres) {
  const d = metres / RADIUS;
  const lat1 = rad(lat);
  const lat2 = Math.asin(Math.sin(lat1) * Math.cos(d) + Math.cos(lat1) * Math.sin(d) * Math.cos(rad(direction)));
  const dLon = Math.atan2(
    Math.sin(rad(direction)) * Math.sin(d) * Math.cos(lat1),
    Math.cos(d) - Math.sin(lat1) * Math.sin(lat2),
  );
  return [lon + deg(dLon), deg(lat2)];
}

// A closed ring around a place.
export function circle(centre, metres, corners = 64) {
  return Array.from({ length: corners + 1 }, (_, n) => destination(centre, (n % corners) * (360 / corners), metres));
}

// The smallest box around positions as [[west, south], [east, north]]; null for none. A fleet on both sides of the date line is
// taken as the shorter way around.
export function bounds(positions) {
  if (positions.length === 0) return null;
  const lats = positions.map(([, lat]) => lat);
  const lons = positions.map(([lon]) => lon);
  let [west, east] = [Math.min(...lons), Math.max(...lons)];
  if (east - west > 180) {
    const shifted = lons.map((lon) => (lon < 0 ? lon + 360 : lon));
    [west, east] = [Math.min(...shifted), Math.max(...shifted)];
  }
  return [[west, Math.min(...lats)], [east, Math.max(...lats)]];
}

// A line whose longitudes go on beyond 180 where it crosses the date line, instead of jumping to the other end of the map.
export function continuous(line) {
  let turns = 0;
  return line.map(([lon, lat], n) => {
    const step = n === 0 ? 0 : lon - line[n - 1][0];
    if (Math.abs(step) > 180) turns -= Math.sign(step) * 360;
    return [lon + turns, lat];
  });
}

export function metresText(metres) {
  if (metres < 10) return `${metres.toFixed(1)} m`;
  if (metres < 1000) return `${Math.round(metres)} m`;
  return metres < 10_000 ? `${(metres / 1000).toFixed(2)} km` : `${(metres / 1000).toFixed(1)} km`;
}

export const feature = (type, coordinates, properties = {}) => ({ type: "Feature", properties, geometry: { type, coordinates } });
export const collection = (features = []) => ({ type: "FeatureCollection", features });
