# What signed links cost, frame by frame, and what links without a key pay for it.
#
#     bin/bench signing [--frames 20000]
#
# Each line is one function of MavRouter.Signing or MavCodec.Signing, called that many times on ATTITUDE frames (28 bytes of
# payload) that were made before: median and p99 of single calls in microseconds (the clock's own reading, which stands in the
# first line, is in each), and reductions. `admit` is what a link does with each read, `sign` and `fill` with each write.

Code.require_file("../../mav_codec/bench/support/options.ex", __DIR__)

alias MavRouter.Signing
alias MavRouter.Signing.{Tables, Verifiers}
alias MavCodec.{Messages, Parser}

Logger.configure(level: :none)
n = MavCodec.Bench.Options.read(__ENV__.file, System.argv(), frames: 20_000)[:frames]
dir = Path.join(System.tmp_dir!(), "aerie-bench-signing-#{System.pid()}")
File.mkdir_p!(dir)
key = :crypto.strong_rand_bytes(32)
file = Path.join(dir, "key")
File.write!(file, "hex:" <> Base.encode16(key))
File.chmod!(file, 0o600)

start = fn keys ->
  gateway = make_ref()
  config = %{signing: %{keys: keys, dir: Path.join(dir, "#{System.unique_integer([:positive])}")}}
  {:ok, _} = Aerie.Base.Store.start_link(gateway: gateway)
  {:ok, _} = Aerie.Base.PubSub.start_link(gateway: gateway)
  {:ok, _} = Signing.Supervisor.start_link(gateway: gateway, settings: Signing.Settings.from(config))
  gateway
end

attitude = fn i, system ->
  MavCodec.encode(%Messages.Attitude{time_boot_ms: i, roll: 0.5, pitch: -0.1, yaw: 1.0},
    system: system,
    component: 1,
    seq: rem(i, 256)
  )
end

frame = fn bytes ->
  {[frame], _} = Parser.push_datagram(Parser.new(), bytes, 1)
  frame
end

extra = 39
plain = for i <- 1..n, do: frame.(attitude.(i, 1))

signed = fn system, start_at ->
  n = if system > 2, do: 1, else: n
  signer = MavCodec.Signing.new(key, stored: start_at)

  {frames, _} =
    Enum.map_reduce(1..n, signer, fn i, signer ->
      {bytes, signer} = MavCodec.Signing.sign(signer, attitude.(i, system), extra)
      {frame.(bytes), signer}
    end)

  frames
end

now = MavCodec.Signing.timestamp(MavCodec.Signing.new(key))
forged = Enum.map(signed.(1, now), &%{&1 | signature: %{&1.signature | signature: <<0::48>>}})

measure = fn name, items, fun ->
  :erlang.garbage_collect()
  {_, before} = Process.info(self(), :reductions)

  {times, _} =
    Enum.map_reduce(items, nil, fn item, state ->
      started = :erlang.monotonic_time(:nanosecond)
      state = fun.(item, state)
      {:erlang.monotonic_time(:nanosecond) - started, state}
    end)

  {_, later} = Process.info(self(), :reductions)
  times = Enum.sort(times)
  count = length(times)
  us = &:erlang.float_to_binary(Enum.at(times, &1) / 1000, decimals: 2)

  IO.puts(
    "#{String.pad_trailing(name, 58)} #{String.pad_leading(us.(div(count, 2)), 8)} #{String.pad_leading(us.(div(count * 99, 100)), 8)} " <>
      String.pad_leading("#{div(later - before, count)}", 6)
  )
end

source = %{id: "radio", network: "main", peer: :a, trust: :radio}
IO.puts("#{String.pad_trailing("", 58)}  p50 us   p99 us   reds")
measure.("the clock's own reading", plain, fn _frame, _ -> nil end)

IO.puts("\nsignatures alone (MavCodec.Signing)")

measure.("check: right", signed.(1, now), fn frame, state ->
  {:signed, state} = MavCodec.Signing.check(state || MavCodec.Signing.new(key), frame)
  state
end)

measure.("check: wrong", forged, fn frame, state ->
  {{:rejected, _}, state} = MavCodec.Signing.check(state || MavCodec.Signing.new(key), frame)
  state
end)

measure.("sign", plain, fn frame, state ->
  {_bytes, state} = MavCodec.Signing.sign(state || MavCodec.Signing.new(key), frame.bytes, extra)
  state
end)

IO.puts("\nlinks without a key")
none = start.([])

measure.("admit, no key in the gateway, 1 frame a read", plain, fn frame, _ ->
  Signing.admit(none, source, [frame])
end)

tens = Enum.chunk_every(plain, 10)

measure.("admit, no key in the gateway, 10 frames a read (a read)", tens, fn frames, _ ->
  Signing.admit(none, source, frames)
end)

other = start.([%{network: "field", key_file: file}])

measure.("admit, keys of another network only, 1 frame", plain, fn frame, _ ->
  Signing.admit(other, source, [frame])
end)

spec = MavRouter.Link.Spec.parse!("udpin:127.0.0.1:0", id: "radio")

measure.("fill, a write without anything to sign, 1 frame", plain, fn frame, _ ->
  Signing.fill(none, spec, :a, [frame.bytes])
end)

IO.puts("\nlinks with a key")
required = start.([%{network: "main", key_file: file}])

measure.("admit, verified, 1 frame", signed.(1, now), fn frame, _ ->
  [_] = Signing.admit(required, source, [frame])
end)

# Later than the first lot.
reads = Enum.chunk_every(signed.(2, now), 10)

measure.("admit, verified, 10 frames a read (a read)", reads, fn frames, _ ->
  Signing.admit(required, source, frames)
end)

# A radio with a whole fleet behind it: what is remembered of each stream goes in and out of a table with each read.
fleet = for system <- 1..250, do: hd(signed.(system, now))
[_ | _] = Signing.admit(required, %{source | id: "fleet"}, fleet)
later = signed.(1, now + 5_000_000)

measure.("admit, verified, 1 frame, 250 streams on the link", later, fn frame, _ ->
  [_] = Signing.admit(required, %{source | id: "fleet"}, [frame])
end)

measure.("admit, refused: unsigned", plain, fn frame, _ -> [] = Signing.admit(required, source, [frame]) end)

measure.("admit, refused: wrong signature", forged, fn frame, _ ->
  [] = Signing.admit(required, source, [frame])
end)

own = MavCodec.encode(%Messages.Heartbeat{}, system: 245, component: 191)
marked = Signing.mark(required, {"main", 1}, own)
measure.("sign, our own frame", 1..n, fn _i, _ -> Signing.sign(required, "radio", :a, marked) end)

measure.("placeholder, a client's frame in the router", plain, fn frame, _ ->
  Signing.placeholder(frame.bytes)
end)

waiting = for frame <- plain, do: Signing.placeholder(frame.bytes)

measure.("fill, a client's frame signed", waiting, fn bytes, _ ->
  Signing.fill(required, spec, :a, [bytes])
end)

IO.puts("\nmemory")
tables = Tables.of(required)
scope = Tables.scope(tables, {"main", 1})
words = fn term -> :erts_debug.flat_size(term) * :erlang.system_info(:wordsize) end

for streams <- [1, 10, 250] do
  map = Map.new(1..streams, &{{0, &1, 1}, now})
  size = words.(MavCodec.Signing.new(key, streams: map, save: fn _ -> :ok end))
  IO.puts("a link's state with #{streams} streams: #{size} bytes")
end

_ = Verifiers.get(required, tables, "radio", scope)

size =
  for({name, table} <- tables, name not in [:active, :events], do: :ets.info(table, :memory)) |> Enum.sum()

IO.puts("all tables, one link, two vehicles: #{div(size * :erlang.system_info(:wordsize), 1024)} KiB")
File.rm_rf!(dir)
