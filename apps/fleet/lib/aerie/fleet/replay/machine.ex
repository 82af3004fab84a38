defmodule Aerie.Fleet.Replay.Machine do
  @moduledoc """
  The pipeline of a gateway without its processes: frames of a recording in, outputs out. A pure value, driven by the
  recording's own times (`Aerie.Fleet.Replay.Clock`), so that the same frames always give the same outputs.

      record ─ parser ─ router's rules ─ vehicle core ─ detector ─▶ {:event, …}
                                                └─ samplers ──────▶ {:sample, …}

  Only those of the router's rules apply that decide what a vehicle's session receives. Our own frames are not a vehicle's
  (but our TIMESYNC requests are needed to recognise its answers) and do not advance time: a gateway that got no time for
  seconds recorded them before what it had not read yet. An autopilot's heartbeat admits a vehicle (H2, H4), other
  heartbeats are noted as stations, and frames of systems without a vehicle are counted. Forwarding does not affect events.

  A recording does not say by which link a frame came. Frames that two links brought are passed on twice, as in a live gateway.
  Only a copy of a text within five seconds is dropped; a live gateway would know it by the link.
  """

  alias Aerie.Fleet.Replay.{Clock, Settings, Vehicle}
  alias MavCodec.Meaning.Heartbeat
  alias MavRouter.Forward.Cache.EarlyTexts
  alias MavRouter.Forward.GroundStations
  alias Aerie.Vehicle.Options
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Timesync
  alias MavCodec.{Frame, Parser, Tlog}
  alias MavCodec.Messages, as: M

  @statustext M.Statustext.id()
  @timesync M.Timesync.id()
  # The messages that say what their sender is.
  @heartbeats [M.Heartbeat.id(), M.HighLatency2.id()]
  # As in `Aerie.Vehicle.Session.Core.Frames`.
  @copy_us 5_000_000
  @copies 64
  @stations_every 10
  @max_damage 100
  @year_2000 946_684_800_000_000

  @enforce_keys [:settings, :network, :link, :own, :max, :parser]
  defstruct @enforce_keys ++
              [
                high_latency: false,
                clock: Clock.new(),
                ticks: 0,
                vehicles: %{},
                stations: %{},
                texts: %{},
                early: EarlyTexts.new(),
                first: nil,
                last: nil,
                damage: [],
                counts: %{
                  frames: 0,
                  bytes: 0,
                  own: 0,
                  copies: 0,
                  unclaimed: 0,
                  refused: 0,
                  jumps: 0,
                  damaged_parts: 0,
                  damaged_bytes: 0
                }
              ]

  @type t :: %__MODULE__{}

  @doc "A machine that has heard nothing; options as in `Aerie.Fleet.Replay.run/2`."
  @spec new(Settings.t(), keyword) :: t
  def new(%Settings{vehicle: vehicle} = settings, options) do
    %__MODULE__{
      settings: vehicle,
      network: options[:network] || vehicle.identity.network,
      link: options[:link] || "replay",
      high_latency: options[:high_latency] || false,
      own: own(vehicle),
      max: vehicle.max_vehicles,
      parser: Parser.new(parser(settings))
    }
  end

  @doc "The parser's options."
  @spec parser(Settings.t()) :: [Parser.option()]
  def parser(settings), do: MavRouter.Link.Settings.parser(settings.link)

  defp own(%{identity: identity}), do: {identity.system_id, identity.component_id}

  @doc "The next frame or damaged part of a recording; returns the outputs in order."
  @spec push(t, Frame.t() | Tlog.Damage.t()) :: {t, [Aerie.Fleet.Replay.output()]}
  def push(machine, %Tlog.Damage{} = damage) do
    kept = if length(machine.damage) < @max_damage, do: [damage | machine.damage], else: machine.damage

    {count(%{machine | damage: kept}, :damaged_parts, 1) |> count(:damaged_bytes, damage.bytes), []}
  end

  def push(machine, %Frame{} = record) do
    {frames, parser} = Parser.push_datagram(machine.parser, record.bytes, record.at)
    machine = count(%{machine | parser: parser}, :bytes, 8 + byte_size(record.bytes))

    {machine, outputs} = Enum.reduce(frames, {machine, []}, &frame/2)
    {machine, Enum.reverse(outputs)}
  end

  defp frame(%{system: system, component: component} = frame, {machine, outputs}) do
    machine = count(%{machine | first: first(machine.first, frame.at), last: frame.at}, :frames, 1)

    if machine.own == {system, component} do
      ours(count(machine, :own, 1), frame, outputs)
    else
      {machine, outputs} = time(machine, frame.at, outputs)
      route(machine, frame, outputs)
    end
  end

  # Time stamps that a recorder wrote before its clock was set do not give the time.
  defp first(nil, at), do: at
  defp first(first, at) when first < @year_2000 and at >= @year_2000, do: at
  defp first(first, _at), do: first

  @doc "The end of a recording: the time after its last frame of somebody else, in which it has our own only."
  @spec finish(t) :: {t, [Aerie.Fleet.Replay.output()]}
  def finish(%{last: last, clock: %{now: now}} = machine) when is_integer(now) and last > now do
    {machine, outputs} = time(machine, last, [])
    {machine, Enum.reverse(outputs)}
  end

  def finish(machine), do: {machine, []}

  ## Time

  defp time(machine, at, outputs) do
    case Clock.advance(machine.clock, at) do
      {:restarted, clock} ->
        machine = count(%{machine | clock: clock}, :jumps, 1)
        each(machine, {:rebase, at}, at, outputs)

      {ticks, clock} ->
        Enum.reduce(ticks, {%{machine | clock: clock}, outputs}, &tick/2)
    end
  end

  defp tick(now, {machine, outputs}) do
    {machine, outputs} = each(machine, {:tick, now}, now, outputs)
    machine = %{machine | ticks: machine.ticks + 1}

    if rem(machine.ticks, @stations_every) == 0,
      do: each(machine, {:stations, stations(machine)}, now, outputs),
      else: {machine, outputs}
  end

  # In the order of their ids, so that nothing depends on a map's internal order.
  defp each(machine, event, at, outputs) do
    machine.vehicles
    |> Map.keys()
    |> Enum.sort()
    |> Enum.reduce({machine, outputs}, fn system, {machine, outputs} ->
      give(machine, system, event, at, outputs)
    end)
  end

  defp give(machine, system, event, at, outputs) do
    {vehicle, outputs} = Vehicle.step(Map.fetch!(machine.vehicles, system), event, at, outputs)
    {%{machine | vehicles: %{machine.vehicles | system => vehicle}}, outputs}
  end

  ## Frames

  defp route(machine, frame, outputs) do
    {copy?, machine} = copy(machine, frame)
    machine = if copy?, do: count(machine, :copies, 1), else: machine |> hear(frame) |> admit(frame)

    cond do
      copy? -> {machine, outputs}
      is_map_key(machine.vehicles, frame.system) -> deliver(machine, frame, outputs)
      true -> {machine |> count(:unclaimed, 1) |> hold(frame), outputs}
    end
  end

  defp hold(machine, frame), do: %{machine | early: EarlyTexts.hold(machine.early, frame.system, [frame])}

  defp deliver(machine, frame, outputs) do
    {texts, early} = EarlyTexts.take(machine.early, frame.system, frame.at)

    give(
      %{machine | early: early},
      frame.system,
      {:frames, machine.link, texts ++ [frame]},
      frame.at,
      outputs
    )
  end

  # A request of the gateway that made the recording, needed to recognise its answer as ours.
  defp ours(machine, %Frame{id: @timesync, crc_extra: extra} = frame, outputs) when extra != nil do
    with {:ok, request} <- MavCodec.decode(frame), true <- Timesync.request?(request) do
      each(machine, {:asked, request, frame.at}, frame.at, outputs)
    else
      _no_request -> {machine, outputs}
    end
  end

  defp ours(machine, _frame, outputs), do: {machine, outputs}

  defp hear(machine, %Frame{id: id, crc_extra: extra} = frame) when id in @heartbeats and extra != nil do
    heartbeat = Heartbeat.read(frame)

    if Heartbeat.vehicle?(heartbeat),
      do: machine,
      else: %{machine | stations: station(machine.stations, frame, heartbeat, machine.link)}
  end

  defp hear(machine, _frame), do: machine

  # As `MavRouter.Forward.GroundStations` in a live gateway, with the same limits.
  defp station(stations, frame, heartbeat, link) do
    key = {frame.system, frame.component}
    stations = if is_map_key(stations, key), do: stations, else: room(stations, frame.at)

    if is_map_key(stations, key) or map_size(stations) < GroundStations.max(),
      do:
        Map.put(stations, key, %{
          system: frame.system,
          component: frame.component,
          type: heartbeat.type,
          via: link,
          last_heard: frame.at
        }),
      else: stations
  end

  defp room(stations, now) do
    if map_size(stations) < GroundStations.max(),
      do: stations,
      else:
        Map.filter(stations, fn {_key, station} -> station.last_heard >= now - GroundStations.forget_us() end)
  end

  # In the order of their ids.
  defp stations(machine), do: machine.stations |> Enum.sort() |> Enum.map(&elem(&1, 1))

  defp admit(%{vehicles: vehicles} = machine, %{system: system}) when is_map_key(vehicles, system),
    do: machine

  defp admit(machine, %Frame{id: id, crc_extra: extra} = frame) when id in @heartbeats and extra != nil do
    cond do
      not Heartbeat.vehicle?(Heartbeat.read(frame)) -> machine
      map_size(machine.vehicles) >= machine.max -> count(machine, :refused, 1)
      true -> put_in(machine.vehicles[frame.system], vehicle(machine, frame.system))
    end
  end

  defp admit(machine, _frame), do: machine

  defp vehicle(machine, system) do
    options = Options.new(machine.settings, {machine.network, system})
    Vehicle.new(options, machine.link, machine.high_latency)
  end

  defp copy(machine, %Frame{id: @statustext} = frame) do
    key = {frame.system, frame.component, frame.seq, frame.payload}

    case machine.texts do
      %{^key => at} when abs(frame.at - at) < @copy_us ->
        {true, machine}

      texts when map_size(texts) < @copies ->
        {false, %{machine | texts: Map.put(texts, key, frame.at)}}

      texts ->
        young = Map.filter(texts, fn {_key, at} -> abs(frame.at - at) < @copy_us end)
        {false, %{machine | texts: young |> bounded() |> Map.put(key, frame.at)}}
    end
  end

  defp copy(machine, _frame), do: {false, machine}

  # In a flood of texts, a copy may be missed.
  defp bounded(texts), do: if(map_size(texts) < 4 * @copies, do: texts, else: %{})

  defp count(machine, what, n), do: %{machine | counts: Map.update!(machine.counts, what, &(&1 + n))}

  ## Result

  @doc "Why this was not a recording, as text; nil if it was."
  @spec unreadable(t) :: String.t() | nil
  def unreadable(%{damage: damage, counts: %{frames: frames}}) do
    case {Enum.find(damage, &(&1.kind == :raw)), frames, damage} do
      {%Tlog.Damage{} = raw, _frames, _damage} -> Tlog.Damage.format(raw)
      {nil, 0, [%{kind: :untimed} = untimed | _]} -> Tlog.Damage.format(untimed)
      {nil, 0, _damage} -> "no MAVLink record found (is it a tlog?)"
      _recording -> nil
    end
  end

  @doc "The vehicles' snapshots by name."
  @spec snapshots(t) :: %{String.t() => map}
  def snapshots(machine) do
    for {system, _vehicle} <- machine.vehicles,
        snapshot = snapshot(machine, system),
        into: %{},
        do: {snapshot.id, snapshot}
  end

  @doc "The snapshot of one vehicle by its system id; nil before it was heard."
  @spec snapshot(t, non_neg_integer) :: map | nil
  def snapshot(%{vehicles: vehicles}, system) do
    case vehicles do
      %{^system => %{core: %{component: component} = core}} when component != nil -> Core.snapshot(core)
      _unheard -> nil
    end
  end

  @doc "See `t:Aerie.Fleet.Replay.summary/0`."
  @spec summary(t) :: Aerie.Fleet.Replay.summary()
  def summary(machine) do
    parser = Parser.stats(machine.parser)

    Map.merge(machine.counts, %{
      vehicles: for({_system, vehicle} <- Enum.sort(machine.vehicles), do: vehicle.options.id),
      stations: stations(machine),
      from: machine.first,
      to: machine.last,
      duration_us: machine.clock.passed,
      unknown_ids: parser.unknown_ids,
      lost: parser.lost,
      sources: parser.sources,
      damage: Enum.reverse(machine.damage)
    })
  end
end
