defmodule Aerie.Vehicle.Services.Gcs do
  @moduledoc """
  Which ground station's heartbeats keep a vehicle's failsafe quiet (H5). A pure value.

  The failsafe for a lost ground station waits for heartbeats. ArduPilot's counts those of system `SYSID_MYGCS`
  (`MAV_GCS_SYSID` to `MAV_GCS_SYSID_HI` since 4.7), PX4's any with MAV_TYPE_GCS. So with two stations on a network the
  one that the vehicle listens to may be gone while the other is still there, and with a wrong parameter there never was
  one. This module knows which one counts and whether it is heard, and reports when it falls silent.

  The parameters are read once, one by one, two seconds apart, and again after a reboot; any other PARAM_VALUE that
  comes is used as well. Unknown values are nil.
  """

  alias MavRouter.Forward.GroundStations
  alias MavCodec.Enums.MavType
  alias MavCodec.Messages.ParamRequestRead

  @ardupilot ~w(SYSID_MYGCS MAV_GCS_SYSID MAV_GCS_SYSID_HI FS_GCS_ENABLE FS_GCS_ENABL FS_GCS_TIMEOUT FS_LONG_TIMEOUT)
  @px4 ~w(NAV_DLL_ACT COM_DL_LOSS_T)
  @names @ardupilot ++ @px4

  @first_us 5_000_000
  @pause_us 2_000_000
  @tries 2
  @known_us 60_000_000
  @shown 16
  @mav_type_gcs MavType.value(:MAV_TYPE_GCS)
  # The firmware's defaults, for when the parameter is not known.
  @timeout_us %{ardupilot: 5_000_000, px4: 10_000_000}

  defstruct autopilot: :generic,
            kind: "unknown",
            params: %{},
            asked: %{},
            next: nil,
            stations: [],
            heard: nil,
            quiet: nil

  @typedoc """
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
  def vehicle(gcs, autopilot, kind), do: %{gcs | autopilot: autopilot, kind: kind}

  @doc "The value of any parameter."
  @spec param(t(), String.t(), number()) :: t()
  def param(gcs, name, value) when name in @names, do: %{gcs | params: Map.put(gcs.params, name, value)}
  def param(gcs, _name, _value), do: gcs

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

    case Enum.find(plan(gcs), &(Map.get(gcs.asked, &1, 0) < @tries and ask?(gcs, &1))) do
      nil ->
        {gcs, []}

      name ->
        gcs = %{gcs | asked: Map.update(gcs.asked, name, 1, &(&1 + 1))}
        request = %ParamRequestRead{target_system: system, target_component: component}
        {gcs, [%{request | param_id: name, param_index: -1}]}
    end
  end

  defp plan(%{autopilot: :ardupilot, kind: kind}) when kind in ["plane", "vtol"],
    do: ~w(SYSID_MYGCS MAV_GCS_SYSID MAV_GCS_SYSID_HI FS_GCS_ENABL FS_LONG_TIMEOUT)

  defp plan(%{autopilot: :ardupilot}),
    do: ~w(SYSID_MYGCS MAV_GCS_SYSID MAV_GCS_SYSID_HI FS_GCS_ENABLE FS_GCS_TIMEOUT)

  defp plan(%{autopilot: :px4}), do: @px4
  defp plan(_generic), do: []

  # A parameter that is known, or has another name in this firmware, is not requested.
  defp ask?(gcs, "MAV_GCS_SYSID_HI"),
    do: is_map_key(gcs.params, "MAV_GCS_SYSID") and not known?(gcs, "MAV_GCS_SYSID_HI")

  defp ask?(gcs, "MAV_GCS_SYSID"),
    do: not is_map_key(gcs.params, "SYSID_MYGCS") and not known?(gcs, "MAV_GCS_SYSID")

  defp ask?(gcs, "SYSID_MYGCS"),
    do: not is_map_key(gcs.params, "MAV_GCS_SYSID") and not known?(gcs, "SYSID_MYGCS")

  defp ask?(gcs, name), do: not known?(gcs, name)

  defp known?(gcs, name), do: is_map_key(gcs.params, name)

  @doc "The system ids that the failsafe listens to: `{lowest, highest}`, `:any_gcs` for any ground station, or nil."
  @spec listens_to(t()) :: {integer(), integer()} | :any_gcs | nil
  def listens_to(%{autopilot: :px4}), do: :any_gcs

  def listens_to(%{autopilot: :ardupilot, params: params}) do
    case params do
      %{"MAV_GCS_SYSID" => low} ->
        {trunc(low), max(trunc(low), trunc(Map.get(params, "MAV_GCS_SYSID_HI", 0)))}

      %{"SYSID_MYGCS" => id} ->
        {trunc(id), trunc(id)}

      _unknown ->
        nil
    end
  end

  def listens_to(_generic), do: nil

  @doc "The ids whose heartbeats keep the failsafe quiet, `:unknown` before they are read, nil if ids do not count."
  @spec obeyed(t()) :: {integer(), integer()} | :unknown | nil
  def obeyed(%{autopilot: :ardupilot} = gcs) do
    case listens_to(gcs) do
      {_low, _high} = ids -> ids
      _unread -> :unknown
    end
  end

  def obeyed(_by_type_or_not_known), do: nil

  @doc "Whether the failsafe is enabled; nil while that is not known."
  @spec enabled?(t()) :: boolean() | nil
  def enabled?(%{autopilot: :px4, params: params}), do: on?(params["NAV_DLL_ACT"])
  def enabled?(%{params: params}), do: on?(params["FS_GCS_ENABLE"] || params["FS_GCS_ENABL"])

  defp on?(nil), do: nil
  defp on?(value), do: value > 0

  @doc "The silence after which the failsafe acts (us)."
  @spec timeout_us(t()) :: pos_integer()
  def timeout_us(%{autopilot: autopilot, params: params}) do
    seconds =
      if autopilot == :px4,
        do: params["COM_DL_LOSS_T"],
        else: params["FS_GCS_TIMEOUT"] || params["FS_LONG_TIMEOUT"]

    if seconds != nil and seconds > 0,
      do: round(seconds * 1_000_000),
      else: Map.get(@timeout_us, autopilot, 5_000_000)
  end

  @doc "Whether heartbeats of this station keep the failsafe quiet."
  @spec keeps_quiet?(t(), %{system: integer(), type: integer()}) :: boolean()
  def keeps_quiet?(gcs, %{system: system, type: type}) do
    case listens_to(gcs) do
      {low, high} -> system in low..high//1
      :any_gcs -> type == @mav_type_gcs
      nil -> false
    end
  end

  @doc """
  For the snapshot:

  - `known_by`: system ids of the ground stations heard within a minute
  - `failsafe_gcs`: the id that the failsafe listens to, nil if unknown or any; `failsafe_range`: the lowest and highest
    id
  - `heard_gcs`, `last_heard`: the system whose heartbeat last kept it quiet, and when (unix us)
  - `quiet?`: whether it is kept quiet now; nil before the first such heartbeat
  - `enabled?`, `timeout_s`: of the failsafe
  - `stations`: each `%{system, component, type, via, last_heard, keeps?}`
  - `params`: those that were read
  """
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
