defmodule MavRouter.Link.Serial.Detector do
  @moduledoc """
  Finds the serial port that is connected to a vehicle: a pure state machine of `MavRouter.Link.Serial.Probe`s, one for each port.

  It listens to the configured ports first, all at once; if none of them has a vehicle, to the others, all at once. The first
  valid heartbeat wins. A port before it in the list that was not yet listened to for long enough gets half a second more, so
  that of two ports of a flight controller it is always the same one.

  | event | meaning |
  |---|---|
  | `{:ports, [port]}` | the existing ports (`Aerie.Base.Net.SerialPorts`); repeated, as they may change |
  | `{key, event}` | an event for the probe of a port |
  | `:tick` | four times a second |

  | action | meaning |
  |---|---|
  | `{:open, key, path, baud}` (repeated while it is in use), `{:set, key, baud}`, `{:close, key}` | open a port, set its baud rate, close it |
  | `{:read, key, ms}` | read once, for at most that long |
  | `{:write, key, bytes}` | ask (only if it searches for MSP) |
  | `{:found, key, finding, bytes}` | the port to use, and what was received; all others are closed |
  | `{:failed, [finding]}` | no port has a vehicle; all are closed |

  No other action writes: nothing is sent before it is known what is at the other end (Q3). After `:found` or `:failed` nothing more
  happens. Time is monotonic ms.
  """

  alias MavRouter.Link.Serial.Finding
  alias MavRouter.Link.Serial.Probe

  # The rate of telemetry radios, that of USB and on-board ports, the fast ones, then the rare ones.
  @bauds [
    57_600,
    115_200,
    921_600,
    460_800,
    500_000,
    230_400,
    1_500_000,
    38_400,
    19_200,
    9_600,
    420_000,
    1_000_000
  ]
  # What a UART has unless somebody changed it, then radios and fast ones; USB answers at any.
  @msp_bauds [115_200, 57_600, 921_600]
  @limit_ms 20_000
  # Before ports are asked they are listened to for longer, and there are two sets of them.
  @ask_limit_ms 40_000
  @grace_ms 500
  @max_probes 32

  @enforce_keys [:bauds]
  defstruct [
    :bauds,
    :started,
    :hit_at,
    :prefer,
    ask: false,
    tier: :configured,
    order: [],
    waiting: [],
    probes: %{},
    over: false
  ]

  @type key :: term
  @type event :: {:ports, [map]} | {key, Probe.event()} | :tick
  @type action ::
          {:open, key, Path.t(), pos_integer}
          | {:set, key, pos_integer}
          | {:read, key, non_neg_integer}
          | {:write, key, binary}
          | {:close, key}
          | {:found, key, Finding.t(), binary}
          | {:failed, [Finding.t()]}
  @type t :: %__MODULE__{}

  @doc "The baud rates that are tried unless the configuration names others, in order."
  @spec bauds() :: [pos_integer, ...]
  def bauds, do: @bauds

  @doc """
  A search before its start. Options: `:bauds` (candidates, in order), `:hint` (`%{path:, baud:}` that was right the last time
  and is tried first), `:ask` (search for a flight controller with MSP, and ask ports that are silent).
  """
  @spec new(keyword) :: t
  def new(options \\ []) do
    ask = options[:ask] || false
    bauds = options[:bauds] || if(ask, do: @msp_bauds, else: @bauds)
    hint = options[:hint]

    %__MODULE__{
      ask: ask,
      bauds: if(hint, do: Enum.uniq([hint.baud | bauds]), else: bauds),
      prefer: hint && hint.path
    }
  end

  @doc "Handles one event."
  @spec handle(t, event, integer) :: {t, [action]}
  def handle(%{over: true} = detector, _event, _now), do: {detector, []}

  def handle(detector, {:ports, ports}, now) do
    detector = %{detector | started: detector.started || now}
    known = Map.keys(detector.probes) ++ Enum.map(detector.waiting, &key/1)
    room = @max_probes - length(known)

    new =
      ports
      |> Enum.uniq_by(&key/1)
      |> Enum.reject(&(key(&1) in known))
      |> Enum.take(room)
      |> Enum.sort_by(&(&1.path != detector.prefer))

    %{detector | waiting: detector.waiting ++ new} |> begin([], now) |> settle(now)
  end

  def handle(%{started: nil} = detector, _event, _now), do: {detector, []}

  def handle(detector, :tick, now) do
    detector.order
    |> Enum.reduce({detector, []}, fn key, {detector, actions} ->
      {detector, more} = probe(detector, key, :tick, now)
      {detector, actions ++ more}
    end)
    |> settle(now)
  end

  def handle(%{probes: probes} = detector, {key, event}, now) when is_map_key(probes, key) do
    detector |> probe(key, event, now) |> settle(now)
  end

  def handle(detector, _unknown_port, _now), do: {detector, []}

  defp probe(detector, key, event, now) do
    {probe, actions} = Probe.handle(detector.probes[key], event, now)
    {%{detector | probes: %{detector.probes | key => probe}}, name(actions, key, probe)}
  end

  # A port that does not exist has no device number.
  defp key(%{key: nil, path: path}), do: path
  defp key(%{key: key}), do: key

  # Starts the probes of the current tier.
  defp begin(detector, actions, now) do
    {now_due, later} =
      Enum.split_with(detector.waiting, &(detector.tier == :rest or &1.origin == :configured))

    Enum.reduce(now_due, {%{detector | waiting: later}, actions}, fn port, {detector, actions} ->
      {probe, more} = Probe.new(port, detector.bauds, now, detector.ask)
      key = key(port)

      {%{detector | order: detector.order ++ [key], probes: Map.put(detector.probes, key, probe)},
       actions ++ name(more, key, probe)}
    end)
  end

  defp name(actions, key, probe) do
    Enum.map(actions, fn
      {:open, baud} -> {:open, key, probe.port.path, baud}
      {what, value} -> {what, key, value}
      :close -> {:close, key}
    end)
  end

  defp settle({detector, actions}, now) do
    hits = Enum.filter(detector.order, &match?({:hit, _, _}, detector.probes[&1].outcome))
    busy = Enum.filter(detector.order, &is_nil(detector.probes[&1].outcome))
    detector = if hits != [] and detector.hit_at == nil, do: %{detector | hit_at: now}, else: detector
    late? = now - detector.started >= if(detector.ask, do: @ask_limit_ms, else: @limit_ms)

    cond do
      hits != [] and (late? or not wait?(detector, hd(hits), busy, now)) -> found(detector, actions, hd(hits))
      hits != [] -> {detector, actions}
      late? -> give_up(detector, actions, busy, now)
      busy != [] -> {detector, actions}
      detector.tier == :configured -> detector |> rest() |> begin(actions, now) |> settle(now)
      true -> failed(detector, actions)
    end
  end

  defp rest(detector), do: %{detector | tier: :rest}

  # Whether a preferred port may still turn out to have a vehicle as well.
  defp wait?(detector, hit, busy, now) do
    before = Enum.take_while(detector.order, &(&1 != hit))
    open? = Enum.any?(before, &(&1 in busy and not Probe.warmed_up?(detector.probes[&1], now)))
    open? and now - detector.hit_at < @grace_ms
  end

  defp found(detector, actions, key) do
    {:hit, finding, bytes} = detector.probes[key].outcome
    others = for other <- detector.order, other != key, open?(detector.probes[other]), do: {:close, other}
    {%{detector | over: true}, actions ++ others ++ [{:found, key, finding, bytes}]}
  end

  # A probe without a result is open, or about to be.
  defp open?(%{outcome: {:over, _finding}}), do: false
  defp open?(_probe), do: true

  defp give_up(detector, actions, busy, now) do
    {detector, actions} =
      Enum.reduce(busy, {detector, actions}, fn key, {detector, actions} ->
        {probe, more} = Probe.stop(detector.probes[key], now)
        {put_in(detector.probes[key], probe), actions ++ name(more, key, probe)}
      end)

    failed(detector, actions)
  end

  defp failed(detector, actions) do
    findings = for key <- detector.order, {:over, finding} <- [detector.probes[key].outcome], do: finding
    {%{detector | over: true}, actions ++ [{:failed, findings}]}
  end
end
