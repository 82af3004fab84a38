# A hub and a companion as two machines, by the guides: companion.md, silent-vehicle.md, and what fleet.md says of the hub's files.
guide docs/guides/companion.md
root hub
root companion
checkout hub
began=$SECONDS before=$(received) machine=$(dpkg --print-architecture)

at hub pilot "$PILOT/aerie"
step 'sudo apt install gcc libc6-dev python3-venv' 'sudo apt install -y gcc libc6-dev python3-venv'
step 'bin/release --arch arm64 --deb' "bin/release --arch $machine --deb"
cp "$root_hub$PILOT/aerie/_build/release/"aerie_*.deb "$root_companion/home/pilot/"
say "the package is made $((SECONDS - began)) s after the first command; $((($(received) - before) / 1000000)) MB were received, and it has $(($(stat -c %s "$root_companion/home/pilot/"*.deb) / 1000000)) MB"
at companion pilot /home/pilot
step 'sudo apt install ./aerie_0.1.0_arm64.deb' "sudo apt install -y ./aerie_0.1.0_$machine.deb"

# In place of the UART: a PTY, with a simulated vehicle behind it.
in_root companion root / 'apt-get install -y -qq --no-install-recommends socat >/dev/null'
in_root hub pilot "$PILOT/aerie/apps/sim_vehicle" 'export PATH="$PWD/../../.toolchain/bin:$PATH"; mix compile' >"$CACHE/compile.log" 2>&1
network hub 10.77.0.1 companion 10.77.0.2
for path in "$root_hub" "$root_companion"; do echo '10.77.0.1 hub.example.org' >>"$path/etc/hosts"; done
in_root companion root / 'exec socat pty,rawer,link=/dev/ttyAMA0,group=dialout,perm=0660 udp4-listen:9999,bind=127.0.0.1' &
net_hub=$net_companion in_root hub pilot "$PILOT/aerie/apps/sim_vehicle" \
  'export PATH="$PWD/../../.toolchain/bin:$PATH"; exec mix sim.fleet --count 1 --firmware ardupilot --to udpout:127.0.0.1:9999' >"$CACHE/vehicle.log" 2>&1 </dev/null &

# systemd does not run in a root like this: what stands for it starts the unit's program with the unit's user, folder and environment.
install -m 755 "$here/systemctl" "$root_companion/usr/local/bin/systemctl"

block 'vehicle_id: VID-001' >"$root_companion/etc/aerie/gateway.yaml"
in_root companion pilot /home/pilot 'sudo -u aerie aerie config check'

at hub pilot "$PILOT/aerie"
step 'aerie nats-setup fleet --host hub.example.org --vehicle VID-001' 'bin/nats-setup fleet --host hub.example.org --vehicle VID-001'
cp -r "$root_hub$PILOT/aerie/fleet/vehicles/VID-001" "$root_companion/home/pilot/"
chroot "$root_companion" chown -R pilot:pilot /home/pilot/VID-001
at companion pilot /home/pilot
step 'sudo install -m 600 -o aerie -g aerie VID-001/leaf.nk VID-001/ca.pem /etc/aerie/'
awk '/^[a-z]/ { keep = /^(nats|shadow|policy):/ } keep' "$root_companion/home/pilot/VID-001/gateway.yaml" >>"$root_companion/etc/aerie/gateway.yaml"
in_root companion pilot /home/pilot 'sudo -u aerie aerie config check'

# The hub, as fleet.md says.
in_root hub pilot "$PILOT/aerie/fleet/hub/hub.example.org" 'exec ../../../.toolchain/bin/nats-server -c hub.conf' >"$CACHE/nats.log" 2>&1 </dev/null &
in_root hub pilot "$PILOT/aerie/fleet/hub" 'exec ../../bin/run --config gateway.yaml' >"$CACHE/hub.log" 2>&1 </dev/null &

step 'sudo systemctl restart aerie'
until_ok 'the companion is ready' step 'sudo -u aerie aerie status'
step 'sudo -u aerie aerie tail VID-001' 'sudo -u aerie aerie tail VID-001 --count 3'
in_root companion pilot /home/pilot 'sudo -u aerie aerie doctor' || say "(doctor: $?)"
guide_ends
until_ok 'the hub shows the vehicle' in_root hub pilot "$PILOT/aerie" 'bin/aerie status | grep "^VID-001 .*gateway-VID-001"'
until_ok 'the hub commands it' in_root hub pilot "$PILOT/aerie" 'bin/aerie cmd VID-001 set_mode mode=GUIDED --yes'
say "the hub commands the companion's vehicle $((SECONDS - began)) s after the first command; $((($(received) - before) / 1000000)) MB were received"

guide docs/guides/silent-vehicle.md
step 'aerie status' 'sudo -u aerie aerie status'
step 'aerie doctor' 'sudo -u aerie aerie doctor || true'
step_says 'aerie probe /dev/ttyUSB0' 'in use' 'sudo -u aerie aerie probe /dev/ttyAMA0 2>&1 || true'
in_root companion root / 'systemctl stop aerie'
step_says 'aerie probe /dev/ttyUSB0' MAVLink 'sudo -u aerie aerie probe /dev/ttyAMA0'
step 'aerie probe udpin:0.0.0.0:14550 --seconds 10' 'aerie probe udpin:0.0.0.0:14550 --seconds 10 || [ $? = 1 ]'
guide_ends

guide docs/signing.md
step 'openssl rand -hex 32 | sudo install -m 600 -o aerie -g aerie /dev/stdin /etc/aerie/main.key'
in_root companion pilot /home/pilot 'sudo -u aerie test -r /etc/aerie/main.key'
