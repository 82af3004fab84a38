defmodule Aerie.Vehicle.Detector do
  @moduledoc """
  Finds events in what is observed of a vehicle. A pure value: `observe(detector, observation, known) -> {detector,
  events, params}`.

  It compares what it is shown with what it was shown last, so being shown the same again (after a crash of the session,
  from a second link) gives nothing. Its whole state is one small term that is committed together with the events.

  Observations, each with the time `at` (us) and the vehicle's clock `boot_ms` (or nil):

  | observation                              | events                                                              |
  |------------------------------------------|---------------------------------------------------------------------|
  | `{:state, at, boot_ms, digest}`          | mode_change, armed, disarmed, takeoff, landed, failsafe, geofence, battery.low, battery.critical, mission.completed |
  | `{:text, at, boot_ms, severity, text}`   | statustext; gcs_failsafe, geofence, mission.completed when it says so |
  | `{:report, at, boot_ms, data}`           | report                                                              |
  | `{:reached, at, boot_ms, seq}`           | mission.reached                                                     |
  | `{:params, at, boot_ms, [{name, value, index}]}` | param_changed                                               |
  | `{:lost, at, boot_ms, silent_us}`, `{:restored, at, boot_ms}` | link.lost, link.restored                       |
  | `{:reboot, at, boot_ms}`                 | reboot                                                              |
  | `{:collision, at, boot_ms, sign, links}` | collision                                                           |
  | `{:streams, at, boot_ms, notices}`       | stream.contested                                                    |
  | `{:gcs, at, boot_ms, what, facts}`       | gcs.lost, gcs.restored                                              |
  | `{:alarm, at, boot_ms, type, data}`      | what somebody else has found: signing.*, displaced                  |
  | `{:quiet, at, boot_ms}`                  | none of its own: nothing was observed for a while                   |

  With any of them may come `events.suppressed`: there is a budget for each type (`Detector.Budget`).

  A digest (`digest/1`) is the part of the state that events are about. The first one is where a vehicle is found, not an
  event; except for a battery that is found low.
  """

  alias Aerie.Vehicle.{Detector, Event, Options, State}

  defstruct [
    :vehicle,
    :battery_low,
    :battery_critical,
    seq: 0,
    done: 0,
    last: %{},
    battery: %{},
    failsafe: nil,
    gcs: false,
    gcs_gone: false,
    fence: nil,
    mission: nil,
    reached: nil,
    lost: false,
    boot_at: nil,
    collision: nil,
    budget: Detector.Budget.new()
  ]

  @type t :: %__MODULE__{
          vehicle: String.t(),
          battery_low: float(),
          battery_critical: float(),
          seq: non_neg_integer(),
          done: non_neg_integer(),
          last: map(),
          battery: %{(0..255 | :own) => Detector.Batteries.level()},
          failsafe: {integer(), String.t(), String.t()} | nil,
          gcs: boolean(),
          gcs_gone: boolean(),
          fence: integer() | nil,
          mission: non_neg_integer() | :unknown | nil,
          reached: {non_neg_integer(), integer()} | nil,
          lost: boolean(),
          boot_at: integer() | nil,
          collision: integer() | nil,
          budget: Detector.Budget.t()
        }

  @type observation :: tuple()
  @type known :: (String.t() -> {:ok, term()} | :error)

  # A reason that was named longer ago than this is not why a failsafe came.
  @reason_us 5_000_000
  # PX4 says once a second that it has reached an item.
  @reached_again_us 5_000_000
  @fence_again_us 10_000_000
  @same_boot_us 10_000_000
  @collision_again_us 60_000_000

  @spec new(Options.t()) :: t()
  def new(options) do
    %__MODULE__{
      vehicle: options.id,
      battery_low: options.battery_low,
      battery_critical: options.battery_critical
    }
  end

  @doc "What of a vehicle's state the detector looks at. Equal digests need not be observed twice."
  @spec digest(State.t()) :: map()
  def digest(state) do
    mode = State.data(state, :mode)
    mission = State.data(state, :mission)

    %{
      mode: mode.mode,
      armed: mode.armed,
      in_air: mode.in_air,
      failsafe: mode.failsafe,
      system_status: mode.system_status,
      fence_breach: mission.fence_breach,
      fence_breach_type: mission.fence_breach_type,
      mission_seq: mission.seq,
      mission_total: mission.total,
      mission_state: mission.state
    }
    |> Map.merge(Detector.Batteries.digest(state))
  end

  @doc "What is shown beside a digest for the data of events, however often it changes."
  @spec beside(State.t()) :: map()
  def beside(state),
    do: %{where: where(State.data(state, :position)), voltages: Detector.Batteries.voltages(state)}

  defp where(%{lat: nil}), do: nil

  defp where(%{lat: lat, lon: lon} = p),
    do: %{"lat" => lat, "lon" => lon, "alt_msl" => p.alt_msl, "alt_rel" => p.alt_rel}

  @doc "One step. `known` gives the value that a parameter had; the new values are in the third element."
  @spec observe(t(), observation(), known()) :: {t(), [Event.t()], %{String.t() => term()}}
  def observe(detector, observation, known \\ fn _name -> :error end)

  def observe(detector, {:state, at, boot_ms, digest}, _known) do
    {beside, digest} = Map.split(digest, [:where, :voltages])
    where = beside[:where]
    now = Map.merge(detector.last, Map.reject(digest, fn {_key, value} -> is_nil(value) end))
    steps = Detector.Changes.events(detector.last, Map.merge(now, beside), detector, at)
    {detector, events} = emit(%{detector | last: now}, steps, at, boot_ms, where)
    {detector, events, %{}}
  end

  def observe(detector, {:text, at, boot_ms, severity, text}, _known) do
    said = [
      {"statustext", %{"severity" => severity, "severity_name" => severity_name(severity), "text" => text},
       []}
    ]

    {detector, events} = emit(detector, said ++ implied(detector, text, at), at, boot_ms, nil)
    {noted(detector, text, at), events, %{}}
  end

  def observe(detector, {:reached, at, boot_ms, seq}, _known) do
    again = match?({^seq, _}, detector.reached) and at - elem(detector.reached, 1) < @reached_again_us
    steps = if again, do: [], else: [{"mission.reached", reached(detector, seq), []}]
    detector = %{detector | reached: {seq, at}, mission: flown_again(detector.mission, seq)}
    {detector, events} = emit(detector, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(detector, {:params, at, boot_ms, values}, known) do
    {steps, learned} =
      Enum.reduce(values, {[], %{}}, fn {name, value, index}, {steps, learned} ->
        before = if is_map_key(learned, name), do: Map.fetch(learned, name), else: known.(name)

        case before do
          {:ok, ^value} -> {steps, learned}
          :error -> {steps, Map.put(learned, name, value)}
          {:ok, old} -> {[param_changed(name, old, value, index) | steps], Map.put(learned, name, value)}
        end
      end)

    {detector, events} = emit(detector, Enum.reverse(steps), at, boot_ms, nil)
    {detector, events, learned}
  end

  def observe(%{lost: false} = detector, {:lost, at, boot_ms, silent_us}, _known) do
    steps = [{"link.lost", %{"silent_s" => Float.round(silent_us / 1_000_000, 1)}, lost: true}]
    {detector, events} = emit(detector, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(%{lost: true} = detector, {:restored, at, boot_ms}, _known) do
    {detector, events} = emit(detector, [{"link.restored", %{}, lost: false}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  # What is known already.
  def observe(detector, {:lost, _at, _boot_ms, _silent_us}, _known), do: {detector, [], %{}}
  def observe(detector, {:restored, _at, _boot_ms}, _known), do: {detector, [], %{}}

  def observe(detector, {:reboot, at, boot_ms}, _known) do
    boot_at = at - boot_ms * 1000

    if detector.boot_at != nil and abs(detector.boot_at - boot_at) < @same_boot_us do
      {detector, [], %{}}
    else
      steps = [
        {"reboot", %{"uptime_ms" => boot_ms}, boot_at: boot_at, mission: nil, reached: nil, gcs: false}
      ]

      {detector, events} = emit(detector, steps, at, boot_ms, nil)
      {detector, events, %{}}
    end
  end

  def observe(detector, {:collision, at, boot_ms, sign, links}, _known) do
    known = detector.collision != nil and at - detector.collision < @collision_again_us
    links = for side <- links, do: Enum.map(side, &to_string/1)
    steps = if known, do: [], else: [{"collision", %{"sign" => sign, "links" => links}, []}]
    {detector, events} = emit(%{detector | collision: at}, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(detector, {:report, at, boot_ms, data}, _known) do
    data = Map.put(data, "severity_name", severity_name(data["severity"]))
    {detector, events} = emit(detector, [{"report", data, []}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(detector, {:quiet, at, boot_ms}, _known) do
    {detector, events} = emit(detector, [], at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(detector, {:alarm, at, boot_ms, type, data}, _known) do
    {detector, events} = emit(detector, [{type, data, []}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  def observe(detector, {:streams, at, boot_ms, notices}, _known) do
    messages =
      for notice <- notices do
        %{
          "id" => notice.id,
          "name" => MavCodec.Dialects.All.name(notice.id),
          "asked_hz" => round_hz(notice.asked),
          "found_hz" => round_hz(notice.measured),
          "yielded" => notice.yielded
        }
      end

    {detector, events} =
      emit(detector, [{"stream.contested", %{"messages" => messages}, []}], at, boot_ms, nil)

    {detector, events, %{}}
  end

  def observe(detector, {:gcs, at, boot_ms, what, facts}, _known) do
    data = %{
      "system" => facts.system,
      "timeout_s" => facts.timeout_s,
      "failsafe_enabled" => facts.enabled
    }

    steps =
      case {what, detector.gcs_gone} do
        {:lost, false} -> [{"gcs.lost", data, gcs_gone: true}]
        {:back, true} -> [{"gcs.restored", %{"system" => facts.system}, gcs_gone: false}]
        _told -> []
      end

    {detector, events} = emit(detector, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  @doc "Why a failsafe that begins `at` came, as far as texts have said: `{reason, text}`."
  @spec reason(t(), integer()) :: {String.t(), String.t() | nil}
  def reason(%{failsafe: {said, reason, text}}, at) when at - said <= @reason_us, do: {reason, text}
  def reason(_detector, _at), do: {"unknown", nil}

  @doc "Whether a breach was told so shortly before `at` that it is the same one."
  @spec fence_told?(t(), integer()) :: boolean()
  def fence_told?(%{fence: nil}, _at), do: false
  def fence_told?(%{fence: told}, at), do: at - told < @fence_again_us

  # Steps are {type, data, changes of the detector}; each event that is within the budget gets the next number. A change
  # is made in any case.
  defp emit(detector, steps, at, boot_ms, where) do
    {budget, suppressed} = Detector.Budget.tell(detector.budget, at)
    told = for data <- suppressed, do: {"events.suppressed", data, []}
    start = number(told, {%{detector | budget: budget}, []}, at, boot_ms)

    {detector, events} =
      Enum.reduce(steps, start, fn {type, data, changes}, {detector, events} ->
        data = if where, do: Map.put(data, "position", where), else: data
        {verdict, budget} = spend(detector.budget, type, data, at)
        step = {if(verdict == :ok, do: type), data, changes}
        number([step], {%{detector | budget: budget}, events}, at, boot_ms)
      end)

    {detector, Enum.reverse(events)}
  end

  defp spend(budget, nil, _data, _at), do: {:ok, budget}
  defp spend(budget, type, data, at), do: Detector.Budget.take(budget, type, data, at)

  defp number(steps, acc, at, boot_ms) do
    Enum.reduce(steps, acc, fn
      {nil, _data, changes}, {detector, events} ->
        {struct!(detector, changes), events}

      {type, data, changes}, {detector, events} ->
        seq = detector.seq + 1
        event = Event.new(detector.vehicle, type, seq, at, boot_ms, data)
        {struct!(detector, [seq: seq] ++ changes), [event | events]}
    end)
  end

  defp implied(detector, text, at) do
    gcs =
      case {Detector.Texts.gcs(text), detector.gcs} do
        {:lost, false} -> [{"gcs_failsafe", %{"text" => text}, gcs: true}]
        {:back, true} -> [{nil, %{}, gcs: false}]
        _nothing_new -> []
      end

    # FENCE_STATUS knows better, where it comes.
    fence =
      if not is_map_key(detector.last, :fence_breach) and Detector.Texts.fence?(text) and
           not fence_told?(detector, at),
         do: [{"geofence", %{"text" => text}, fence: at}],
         else: []

    mission =
      if detector.mission == nil and Detector.Texts.mission_completed?(text),
        do: [{"mission.completed", %{"text" => text}, mission: detector.last[:mission_seq] || :unknown}],
        else: []

    gcs ++ fence ++ mission
  end

  defp noted(detector, text, at) do
    case Detector.Texts.failsafe(text) do
      nil ->
        detector

      # A general "failsafe activated" does not replace the reason that was given just before it.
      "unknown" ->
        if elem(reason(detector, at), 0) == "unknown",
          do: noted(detector, at, "unknown", text),
          else: detector

      reason ->
        noted(detector, at, reason, text)
    end
  end

  defp noted(detector, at, reason, text), do: %{detector | failsafe: {at, reason, text}}

  defp reached(%{last: %{mission_total: total}}, seq), do: %{"seq" => seq, "total" => total}
  defp reached(_detector, seq), do: %{"seq" => seq}

  # An earlier item was reached after the end: the mission is flown again.
  defp flown_again(completed, seq) when is_integer(completed) and seq < completed, do: nil
  defp flown_again(completed, _seq), do: completed

  defp param_changed(name, old, value, index) do
    {"param_changed", %{"name" => name, "from" => old, "to" => value, "index" => index}, []}
  end

  defp round_hz(nil), do: nil
  defp round_hz(hz), do: Float.round(hz * 1.0, 2)

  defp severity_name(severity), do: MavCodec.Enums.MavSeverity.label(severity) || "SEVERITY(#{severity})"
end
