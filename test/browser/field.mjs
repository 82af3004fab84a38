// Draws a made-up airfield around the simulator's home, as tiles for the pictures of the console: FOLDER/Z/X/Y.png.
// No map data belongs in the repository, and none is fetched.
import { mkdirSync, writeFileSync } from "node:fs";
import { crc32, deflateSync } from "node:zlib";

const HOME = { lat: 47.397742, lon: 8.545594 };
const SIDE = 256;
// Metres around home, and the zooms with tiles.
const AROUND = 900;
const ZOOMS = [14, 15, 16, 17];
const METRES_OF_LAT = 111_320;
const METRES_OF_LON = METRES_OF_LAT * Math.cos((HOME.lat * Math.PI) / 180);

const hash = (x, y) => {
  const n = Math.sin(x * 127.1 + y * 311.7) * 43_758.5453;
  return n - Math.floor(n);
};
const MEADOWS = [[205, 217, 180], [214, 222, 188], [222, 217, 178], [198, 212, 172], [210, 206, 168]];
const [RUNWAY, LINE, ROAD] = [[168, 170, 174], [240, 240, 238], [236, 232, 222]];
const [TREE, ROOF, APRON] = [[150, 178, 134], [186, 160, 146], [190, 192, 194]];

// The colour of a point, metres east and north of home.
function ground(east, north) {
  // Along and across the runway, which lies 20 degrees off the north.
  const along = north * 0.94 + east * 0.342;
  const across = east * 0.94 - north * 0.342 + 60;
  if (Math.abs(across) < 12 && Math.abs(along) < 330) {
    const ends = Math.abs(along) > 300 && Math.abs(across) < 9 && Math.abs(across % 4) < 2;
    return ends || (Math.abs(across) < 0.8 && ((along % 40) + 40) % 40 < 22) ? LINE : RUNWAY;
  }
  if (across > 12 && across < 70 && Math.abs(along) < 5) return APRON;
  if (across > 55 && across < 95 && along > -45 && along < 45) {
    return across > 75 && ((along % 30) + 30) % 30 < 22 ? ROOF : APRON;
  }
  if (Math.abs(across - 240 - 40 * Math.sin(along / 260)) < 4) return ROAD;
  if (Math.abs(along + 420 + 30 * Math.sin(across / 200)) < 3) return ROAD;
  const [tx, ty] = [Math.floor(east / 26), Math.floor(north / 26)];
  const wood = hash(Math.floor(tx / 4), Math.floor(ty / 4)) > 0.86 && across > 120;
  if (wood || (hash(tx, ty) > 0.985 && across > 100)) {
    const [cx, cy] = [(tx + 0.4 + 0.2 * hash(tx, ty + 9)) * 26, (ty + 0.4 + 0.2 * hash(tx + 9, ty)) * 26];
    if ((east - cx) ** 2 + (north - cy) ** 2 < (6 + 4 * hash(ty, tx)) ** 2) return TREE;
  }
  const strip = Math.floor((across + 2_000) / 85);
  return MEADOWS[Math.floor(hash(strip, Math.floor((along + 2_000 + 60 * hash(strip, 3)) / 190)) * MEADOWS.length)];
}

const tileX = (lon, zoom) => ((lon + 180) / 360) * 2 ** zoom;
const tileY = (lat, zoom) => ((1 - Math.asinh(Math.tan((lat * Math.PI) / 180)) / Math.PI) / 2) * 2 ** zoom;
const lonOf = (x, zoom) => (x / 2 ** zoom) * 360 - 180;
const latOf = (y, zoom) => (Math.atan(Math.sinh(Math.PI * (1 - (2 * y) / 2 ** zoom))) * 180) / Math.PI;

function chunk(type, data) {
  const body = Buffer.concat([Buffer.from(type, "latin1"), data]);
  const around = Buffer.alloc(8);
  around.writeUInt32BE(data.length, 0);
  around.writeUInt32BE(crc32(body), 4);
  return Buffer.concat([around.subarray(0, 4), body, around.subarray(4)]);
}

function png(colour) {
  const rows = Buffer.alloc(SIDE * (1 + 3 * SIDE));
  for (let y = 0; y < SIDE; y += 1) {
    for (let x = 0; x < SIDE; x += 1) rows.set(colour(x + 0.5, y + 0.5), y * (1 + 3 * SIDE) + 1 + 3 * x);
  }
  const head = Buffer.from([0, 0, 0, 0, 0, 0, 0, 0, 8, 2, 0, 0, 0]);
  head.writeUInt32BE(SIDE, 0);
  head.writeUInt32BE(SIDE, 4);
  const signature = Buffer.from([137, 80, 78, 71, 13, 10, 26, 10]);
  const chunks = [chunk("IHDR", head), chunk("IDAT", deflateSync(rows)), chunk("IEND", Buffer.alloc(0))];
  return Buffer.concat([signature, ...chunks]);
}

const [folder] = process.argv.slice(2);
const [dLat, dLon] = [AROUND / METRES_OF_LAT, AROUND / METRES_OF_LON];
for (const zoom of ZOOMS) {
  for (let x = Math.floor(tileX(HOME.lon - dLon, zoom)); x <= tileX(HOME.lon + dLon, zoom); x += 1) {
    mkdirSync(`${folder}/${zoom}/${x}`, { recursive: true });
    for (let y = Math.floor(tileY(HOME.lat + dLat, zoom)); y <= tileY(HOME.lat - dLat, zoom); y += 1) {
      const colour = (px, py) => {
        const [lon, lat] = [lonOf(x + px / SIDE, zoom), latOf(y + py / SIDE, zoom)];
        return ground((lon - HOME.lon) * METRES_OF_LON, (lat - HOME.lat) * METRES_OF_LAT);
      };
      writeFileSync(`${folder}/${zoom}/${x}/${y}.png`, png(colour));
    }
  }
}
