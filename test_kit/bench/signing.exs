# What signed links cost, frame by frame, and what links without a key pay for it.
#
#     bin/bench signing [--frames 20000]
#
# Each line is one function of MavRouter.Signing or MavCodec.Signing, called that many times on ATTITUDE frames (28
# bytes of payload) that were made before: median and p99 of single calls in microseconds (the clock's own reading,
# which stands in the first line, is in each), and reductions. `admit` is what a link does with each read, `sign` and
# `fill` with each write.

Code.require_file("harness.exs", __DIR__)

defmodule SigningBench do
  alias Bench.{Sample, Table}
  alias MavCodec.Signing, as: Signatures
  alias MavCodec.{Messages, Parser}
  alias MavRouter.Signing
  alias MavRouter.Signing.{Tables, Verifiers}

  @widths [58, -9, -9, -7]
  @crc_extra 39
  @source %{id: "radio", network: "main", peer: :a, trust: :radio}

  def main(dir, n) do
    key = :crypto.strong_rand_bytes(32)
    file = Path.join(dir, "key")
    File.write!(file, "hex:" <> Base.encode16(key))
    File.chmod!(file, 0o600)
    now = Signatures.timestamp(Signatures.new(key))
    signed = fn system, count, at -> signed(Signatures.new(key, stored: at), system, count) end

    first = signed.(1, n, now)

    frames = %{
      plain: for(i <- 1..n, do: frame(attitude(i, 1))),
      signed: first,
      later: signed.(2, n, now),
      last: signed.(1, n, now + 5_000_000),
      fleet: for(system <- 1..250, do: hd(signed.(system, 1, now))),
      forged: for(frame <- first, do: %{frame | signature: %{frame.signature | signature: <<0::48>>}})
    }

    Table.columns(["", "p50 us", "p99 us", "reds"], @widths)
    measure("the clock's own reading", frames.plain, fn _frame, _ -> nil end)
    signatures(key, frames)
    start = fn keys -> start(Path.join(dir, "#{System.unique_integer([:positive])}"), keys) end
    spec = MavRouter.Link.Spec.parse!("udpin:127.0.0.1:0", id: "radio")
    without_key(start.([]), start.([%{network: "field", key_file: file}]), spec, frames.plain)
    required = start.([%{network: "main", key_file: file}])
    with_key(required, spec, frames, n)
    memory(required, key, now)
  end

  defp start(dir, keys) do
    gateway = make_ref()
    settings = Signing.Settings.from(%{signing: %{keys: keys, dir: dir}})

    for module <- [Aerie.Base.Store, Aerie.Base.PubSub, Signing.Supervisor],
        do: {:ok, _} = module.start_link(gateway: gateway, settings: settings)

    gateway
  end

  defp attitude(i, system) do
    message = %Messages.Attitude{time_boot_ms: i, roll: 0.5, pitch: -0.1, yaw: 1.0}
    MavCodec.encode(message, system: system, component: 1, seq: rem(i, 256))
  end

  defp frame(bytes) do
    {[frame], _} = Parser.push_datagram(Parser.new(), bytes, 1)
    frame
  end

  defp signed(signer, system, count) do
    {frames, _} =
      Enum.map_reduce(1..count, signer, fn i, signer ->
        {bytes, signer} = Signatures.sign(signer, attitude(i, system), @crc_extra)
        {frame(bytes), signer}
      end)

    frames
  end

  defp measure(name, items, fun) do
    :erlang.garbage_collect()
    {_us, reductions, times} = Sample.cost(fn -> Sample.calls(items, fun) end)
    figures = for ns <- Sample.spread(times, [0.5, 0.99]), do: :erlang.float_to_binary(ns / 1000, decimals: 2)
    Table.columns([name | figures] ++ [div(reductions, length(times))], @widths)
  end

  defp signatures(key, frames) do
    IO.puts("\nsignatures alone (MavCodec.Signing)")

    measure("check: right", frames.signed, fn frame, state ->
      {:signed, state} = Signatures.check(state || Signatures.new(key), frame)
      state
    end)

    measure("check: wrong", frames.forged, fn frame, state ->
      {{:rejected, _}, state} = Signatures.check(state || Signatures.new(key), frame)
      state
    end)

    measure("sign", frames.plain, fn frame, state ->
      {_bytes, state} = Signatures.sign(state || Signatures.new(key), frame.bytes, @crc_extra)
      state
    end)
  end

  defp without_key(none, other, spec, plain) do
    IO.puts("\nlinks without a key")
    admit = fn gateway -> fn frames, _ -> Signing.admit(gateway, @source, List.wrap(frames)) end end
    measure("admit, no key in the gateway, 1 frame a read", plain, admit.(none))

    measure(
      "admit, no key in the gateway, 10 frames a read (a read)",
      Enum.chunk_every(plain, 10),
      admit.(none)
    )

    measure("admit, keys of another network only, 1 frame", plain, admit.(other))

    measure("fill, a write without anything to sign, 1 frame", plain, fn frame, _ ->
      Signing.fill(none, spec, :a, [frame.bytes])
    end)
  end

  defp with_key(required, spec, frames, n) do
    IO.puts("\nlinks with a key")
    # What is remembered of a whole fleet behind a radio goes in and out of a table with each read.
    fleet = %{@source | id: "fleet"}
    [_ | _] = Signing.admit(required, fleet, frames.fleet)
    own = MavCodec.encode(%Messages.Heartbeat{}, system: 245, component: 191)
    marked = Signing.mark(required, {"main", 1}, own)
    waiting = for frame <- frames.plain, do: Signing.placeholder(frame.bytes)

    for {name, items, fun} <- [
          {"admit, verified, 1 frame", frames.signed, &([_] = Signing.admit(required, @source, [&1]))},
          {"admit, verified, 10 frames a read (a read)", Enum.chunk_every(frames.later, 10),
           &Signing.admit(required, @source, &1)},
          {"admit, verified, 1 frame, 250 streams on the link", frames.last,
           &([_] = Signing.admit(required, fleet, [&1]))},
          {"admit, refused: unsigned", frames.plain, &([] = Signing.admit(required, @source, [&1]))},
          {"admit, refused: wrong signature", frames.forged, &([] = Signing.admit(required, @source, [&1]))},
          {"sign, our own frame", Enum.to_list(1..n),
           fn _i -> Signing.sign(required, "radio", :a, marked) end},
          {"placeholder, a client's frame in the router", frames.plain, &Signing.placeholder(&1.bytes)},
          {"fill, a client's frame signed", waiting, &Signing.fill(required, spec, :a, [&1])}
        ],
        do: measure(name, items, fn item, _last -> fun.(item) end)
  end

  defp memory(required, key, now) do
    IO.puts("\nmemory")
    tables = Tables.of(required)
    word = :erlang.system_info(:wordsize)

    for streams <- [1, 10, 250] do
      state = Signatures.new(key, streams: Map.new(1..streams, &{{0, &1, 1}, now}), save: fn _ -> :ok end)
      IO.puts("a link's state with #{streams} streams: #{:erts_debug.flat_size(state) * word} bytes")
    end

    _ = Verifiers.get(required, tables, "radio", Tables.scope(tables, {"main", 1}))
    words = for {name, table} <- tables, name not in [:active, :events], do: :ets.info(table, :memory)
    IO.puts("all tables, one link, two vehicles: #{div(Enum.sum(words) * word, 1024)} KiB")
  end
end

options = Bench.Options.read(__ENV__.file, frames: 20_000)
Bench.Gateway.in_folder("signing", &SigningBench.main(&1, options[:frames]))
