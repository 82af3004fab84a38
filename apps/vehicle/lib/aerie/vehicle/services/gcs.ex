defmodule Aerie.Vehicle.Services.Gcs do
  @moduledoc """
  Which ground station's heartbeats keep a vehicle's failsafe quiet (H5). A pure value.

  The failsafe for a lost ground station waits for heartbeats, of any station or of those that parameters name
  (`Aerie.Vehicle.Firmware.GroundStation`). So with two stations on a network the one that the vehicle listens to may be
  gone while the other is still there, and with a wrong parameter there never was one. This module knows which one
  counts and whether it is heard, and reports when it falls silent.

  The parameters are read once, one by one, two seconds apart, and again after a reboot; any other PARAM_VALUE that
  comes is used as well. Unknown values are nil.
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Firmware
  alias Aerie.Vehicle.Firmware.GroundStation
  alias MavRouter.Forward.GroundStations
  alias MavCodec.Enums.MavType
  alias MavCodec.Messages.ParamRequestRead

  @first_us 5_000_000
  @pause_us 2_000_000
  @tries 2
  @known_us 60_000_000
  @shown 16
  @mav_type_gcs MavType.value(:MAV_TYPE_GCS)

  defstruct autopilot: :generic,
            kind: "unknown",
            station: nil,
            params: %{},
            asked: %{},
            next: nil,
            stations: [],
            heard: nil,
            quiet: nil

  @typedoc """
  - `station`: which one counts, by the vehicle's firmware and kind; every tick asks for it
  - `asked`: how often each parameter was requested since the vehicle's boot
  - `heard`: `{time, system}` of the last heartbeat that keeps the failsafe quiet
  - `quiet`: whether the failsafe is kept quiet; nil before the first such heartbeat. A loss
    that was reported is kept over a restart and a break of time, so that its end is reported as well
  """
  @type t :: %__MODULE__{}
  @type notice :: {:lost | :back, at :: integer(), map()}

  @doc "Nothing known, or what a snapshot's `gcs` shows."
  @spec new(map() | nil) :: t()
  def new(shown \\ nil)
  def new(%{params: params} = shown), do: %__MODULE__{params: params, quiet: lost(shown[:quiet?])}
  def new(_nothing), do: %__MODULE__{}

  defp lost(quiet), do: if(quiet == false, do: false)

  @doc "The vehicle's firmware and kind, which decide which parameters count."
  @spec vehicle(t(), atom(), String.t()) :: t()
  def vehicle(%{autopilot: autopilot, kind: kind} = gcs, autopilot, kind), do: gcs

  def vehicle(gcs, autopilot, kind),
    do: %{gcs | autopilot: autopilot, kind: kind, station: Firmware.ground_station(autopilot, kind)}

  @doc "The value of any parameter."
  @spec param(t(), String.t(), number()) :: t()
  def param(gcs, name, value) do
    # The heartbeat may come later than the parameter.
    if Enum.any?(Firmware.names(), &(name in GroundStation.names(Firmware.ground_station(&1, gcs.kind)))),
      do: %{gcs | params: Map.put(gcs.params, name, value)},
      else: gcs
  end

  @doc "After a reboot the parameters are read again: they may have been changed before it."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(gcs, at), do: %{gcs | asked: %{}, next: at + @first_us}

  @doc "Time goes on from `now`, which is not comparable with the time before: stations are unheard."
  @spec rebased(t(), integer()) :: t()
  def rebased(gcs, now),
    do: %{gcs | next: gcs.next && now + @pause_us, heard: nil, quiet: lost(gcs.quiet), stations: []}

  @doc "The clock was set by `step` (us): a station was heard as long ago as before."
  @spec shifted(t(), integer()) :: t()
  def shifted(gcs, step) do
    heard = with {at, system} <- gcs.heard, do: {at + step, system}
    stations = Enum.map(gcs.stations, &%{&1 | last_heard: &1.last_heard + step})
    %{gcs | next: gcs.next && gcs.next + step, heard: heard, stations: stations}
  end

  @doc """
  The stations heard on the vehicle's network (`MavRouter.Forward.GroundStations`), without ourselves; another
  component with our system id is another station.
  """
  @spec stations(t(), [GroundStations.station()], own :: {system :: integer(), component :: integer()}) :: t()
  def stations(gcs, stations, own) do
    stations = Enum.reject(stations, &({&1.system, &1.component} == own))
    # nil, an atom, is less than any tuple.
    keepers = for station <- stations, keeps_quiet?(gcs, station), do: {station.last_heard, station.system}
    %{gcs | stations: stations, heard: Enum.max([gcs.heard | keepers])}
  end

  @doc "The parameter to request at `now`, and whether the station that counts fell silent or is back."
  @spec expire(t(), integer(), target :: {integer(), integer()}, ask :: boolean()) ::
          {t(), [ParamRequestRead.t()], [notice()]}
  def expire(gcs, now, target, ask) do
    {gcs, notices} = evaluate(gcs, now)
    {gcs, messages} = if ask, do: ask(gcs, now, target), else: {gcs, []}
    {gcs, messages, notices}
  end

  defp evaluate(%{heard: nil} = gcs, _now), do: {gcs, []}

  defp evaluate(%{heard: {at, system}} = gcs, now) do
    timeout = timeout_us(gcs)
    quiet = now - at < timeout
    facts = %{system: system, timeout_s: timeout / 1_000_000, enabled: enabled?(gcs)}

    notices =
      case {gcs.quiet, quiet} do
        {true, false} -> [{:lost, at + timeout, facts}]
        {false, true} -> [{:back, at, facts}]
        _as_before -> []
      end

    {%{gcs | quiet: quiet}, notices}
  end

  defp ask(%{next: nil} = gcs, now, _target), do: {%{gcs | next: now + @first_us}, []}
  defp ask(%{next: next} = gcs, now, _target) when now < next, do: {gcs, []}

  defp ask(gcs, now, {system, component}) do
    gcs = %{gcs | next: now + @pause_us}

    case Enum.find(station(gcs).asks, &(Map.get(gcs.asked, &1, 0) < @tries and ask?(gcs, &1))) do
      nil ->
        {gcs, []}

      name ->
        gcs = %{gcs | asked: Map.update(gcs.asked, name, 1, &(&1 + 1))}
        request = %ParamRequestRead{target_system: system, target_component: component}
        {gcs, [%{request | param_id: name, param_index: -1}]}
    end
  end

  # A parameter that is known, or has another name in this firmware, is not requested.
  defp ask?(%{params: params} = gcs, name) do
    ids = station(gcs).ids

    not is_map_key(params, name) and
      case Enum.find(ids, fn {low, high} -> name in [low, high] end) do
        nil -> true
        {low, ^name} -> is_map_key(params, low)
        {_low, _high} -> not Enum.any?(ids, fn {low, _high} -> is_map_key(params, low) end)
      end
  end

  defp station(%{station: nil} = gcs), do: Firmware.ground_station(gcs.autopilot, gcs.kind)
  defp station(%{station: station}), do: station

  # The system ids that the failsafe listens to: `{lowest, highest}`, `:any_gcs` for any ground station, or nil.
  defp listens_to(gcs) do
    station = station(gcs)
    if station.listens_to == :any, do: :any_gcs, else: ids(station, gcs.params)
  end

  defp ids(%{ids: ids}, params) do
    Enum.find_value(ids, fn {low, high} ->
      id = params[low]
      if id != nil, do: {trunc(id), max(trunc(id), trunc(params[high] || 0))}
    end)
  end

  @doc "The ids whose heartbeats keep the failsafe quiet, `:unknown` before they are read, nil if ids do not count."
  @spec obeyed(t()) :: {integer(), integer()} | :unknown | nil
  def obeyed(gcs) do
    station = station(gcs)
    if station.listens_to == :ids, do: ids(station, gcs.params) || :unknown
  end

  @doc "Whether the failsafe is enabled; nil while that is not known."
  @spec enabled?(t()) :: boolean() | nil
  def enabled?(gcs), do: with(value when value != nil <- first(gcs, station(gcs).enabled), do: value > 0)

  # The silence after which the failsafe acts (us).
  defp timeout_us(gcs) do
    station = station(gcs)
    seconds = first(gcs, station.timeout)
    if seconds != nil and seconds > 0, do: round(seconds * 1_000_000), else: station.timeout_us
  end

  defp first(gcs, names), do: Enum.find_value(names, &gcs.params[&1])

  @doc "Whether heartbeats of this station keep the failsafe quiet."
  @spec keeps_quiet?(t(), %{system: integer(), type: integer()}) :: boolean()
  def keeps_quiet?(gcs, %{system: system, type: type}) do
    case listens_to(gcs) do
      {low, high} -> system in low..high//1
      :any_gcs -> type == @mav_type_gcs
      nil -> false
    end
  end

  @station Object.fields([
             {:system, :integer, nil, "system id"},
             {:component, :integer, nil, "component id"},
             {:type, :integer, nil, "MAV_TYPE; 6 is a ground station"},
             {:via, :text, nil, "link or client that it is heard by"},
             {:last_heard, :time, nil, "time of its last heartbeat"},
             {:keeps, :boolean, nil, "whether the failsafe listens to it", :keeps?}
           ])
  @fields Object.fields([
            {:known_by, {:list, :integer}, nil, "ids of the ground stations heard within a minute"},
            {:failsafe_gcs, :integer, nil, "the id that the failsafe listens to; null if unknown or any"},
            {:failsafe_range, {:list, :integer}, nil, "lowest and highest id that it listens to",
             &__MODULE__.range/1},
            {:heard_gcs, :integer, nil, "id of the station whose heartbeat last kept it quiet"},
            {:last_heard, :time, nil, "time of that heartbeat"},
            {:quiet, :boolean, nil, "whether it is kept quiet now; null before the first such heartbeat",
             from: :quiet?,
             metric:
               {"gateway_vehicle_gcs_failsafe_quiet",
                "1 while the ground station that its failsafe listens to is heard, 0 while it is gone."}},
            {:enabled, :boolean, nil, "whether it is enabled", :enabled?},
            {:timeout_s, :number, "s", "the silence after which it acts"},
            {:kept_by_gateway, :boolean, nil, "whether the gateway's own heartbeat keeps it quiet", :by_us?},
            {:withheld, :boolean, nil,
             "whether the gateway withholds its heartbeat so as not to be taken for a ground station",
             :withheld?},
            {:params, {:map, :number}, nil, "the parameters that this is known from"},
            {:stations, {:list, {:object, @station}}, nil, "what else sends heartbeats on the network:"}
          ])

  @doc "What people are shown of `show/2`, and of `:by_us?` and `:withheld?` beside it."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc false
  @spec range(map()) :: [non_neg_integer()] | nil
  def range(%{failsafe_range: range}), do: with({low, high} <- range, do: [low, high])

  @doc "For the snapshot."
  @spec show(t(), integer()) :: map()
  def show(gcs, now) do
    near = Enum.filter(gcs.stations, &(now - &1.last_heard < @known_us))
    range = with :any_gcs <- listens_to(gcs), do: nil
    {last_heard, system} = gcs.heard || {nil, nil}

    %{
      known_by: for(%{type: @mav_type_gcs, system: system} <- near, uniq: true, do: system) |> Enum.sort(),
      failsafe_gcs: range && elem(range, 0),
      failsafe_range: range,
      heard_gcs: system,
      last_heard: last_heard,
      quiet?: gcs.quiet,
      enabled?: enabled?(gcs),
      timeout_s: timeout_us(gcs) / 1_000_000,
      stations: near |> Enum.take(@shown) |> Enum.map(&Map.put(&1, :keeps?, keeps_quiet?(gcs, &1))),
      params: gcs.params
    }
  end
end
