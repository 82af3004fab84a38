defmodule Aerie.Vehicle.Detector do
  @moduledoc """
  Finds events in what is observed of a vehicle. A pure value: `observe(detector, observation, known) -> {detector,
  events, params}`.

  It compares what it is shown with what it was shown last, so being shown the same again (after a crash of the session,
  from a second link) gives nothing. Its whole state is one small term that is committed together with the events.

  Observations, each with the time `at` (us) and the vehicle's clock `boot_ms` (or nil):

  | observation                              | events                                                              |
  |------------------------------------------|---------------------------------------------------------------------|
  | `{:state, at, boot_ms, digest}`          | mode_change, armed, disarmed, takeoff, landed, failsafe, geofence, battery, rc, gps, position, mission.completed |
  | `{:text, at, boot_ms, severity, text}`   | statustext; failsafe, gcs_failsafe, geofence, rc, kill_switch, mission.completed when it says so |
  | `{:report, at, boot_ms, data}`           | report                                                              |
  | `{:said, at, boot_ms, name, values, where}` | failsafe, gcs_failsafe, rc, kill_switch: reports at once (`Detector.Reported`) |
  | `{:settle, at, boot_ms, where}`          | failsafe, when it has waited long enough for its cause              |
  | `{:reached, at, boot_ms, seq}`           | mission.reached                                                     |
  | `{:params, at, boot_ms, [{name, value, index}]}` | param_changed                                               |
  | `{:lost, at, boot_ms, silent_us}`, `{:restored, at, boot_ms}` | link.lost, link.restored                       |
  | `{:unheard, at, since}`                  | link.lost: known before the gateway was started, not heard since    |
  | `{:reboot, at, boot_ms}`                 | reboot                                                              |
  | `{:collision, at, boot_ms, sign, links}` | collision                                                           |
  | `{:streams, at, boot_ms, notices}`       | stream.contested                                                    |
  | `{:gcs, at, boot_ms, what, facts}`       | gcs.lost, gcs.restored                                              |
  | `{:alarm, at, boot_ms, type, data}`      | what somebody else has found: signing.*, displaced                  |
  | `{:quiet, at, boot_ms}`                  | none of its own: nothing was observed for a while                   |

  With any of them may come `events.suppressed`: there is a budget for each type (`Detector.Budget`).

  A digest (`Detector.Digest`) is the part of the state that events are about. The first one is where a vehicle is found, not an
  event; except for a battery that is found low, a failsafe, which is marked as found, and what changed while the gateway was
  not there (`Detector.Found`).
  """

  alias Aerie.Fleet.Json
  alias Aerie.Vehicle.{Detector, Event, Options}
  alias Aerie.Vehicle.Detector.{Failsafe, Losses, Reported, Texts}

  defstruct [
    :vehicle,
    :battery_low,
    :battery_critical,
    seq: 0,
    done: 0,
    last: %{},
    battery: %{},
    failsafe: %Failsafe{},
    gcs: false,
    gcs_gone: false,
    gcs_reported: nil,
    reports: false,
    armed_by: nil,
    rc_lost: nil,
    gps_lost: nil,
    position_lost: nil,
    killed: false,
    fence: nil,
    fence_open: nil,
    mission: nil,
    at_last: nil,
    reached: nil,
    lost: false,
    boot_at: nil,
    collision: nil,
    found: nil,
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
          failsafe: Failsafe.t(),
          gcs: boolean(),
          gcs_gone: boolean(),
          gcs_reported: integer() | nil,
          reports: boolean(),
          armed_by: {integer(), armed :: boolean(), reason :: term()} | nil,
          rc_lost: integer() | nil,
          gps_lost: integer() | nil,
          position_lost: integer() | nil,
          killed: boolean(),
          fence: integer() | nil,
          fence_open: {integer(), String.t() | nil} | nil,
          mission: non_neg_integer() | :unknown | nil,
          at_last: {seq :: non_neg_integer(), total :: non_neg_integer()} | nil,
          reached: {non_neg_integer(), integer()} | nil,
          lost: boolean() | :unheard,
          boot_at: integer() | nil,
          collision: integer() | nil,
          found: Detector.Found.t(),
          budget: Detector.Budget.t()
        }

  @type observation :: tuple()
  @type known :: (String.t() -> {:ok, term()} | :error)
  @typedoc "When and where something happened: unix us, the vehicle's clock, its position."
  @type moment :: {integer(), non_neg_integer() | nil, map() | nil}
  @typedoc """
  An event to be: its type (nil for a change of the detector alone), data, changes of the detector, and its own moment where
  that is an earlier one.
  """
  @type step :: {String.t() | nil, map(), keyword()} | {String.t() | nil, map(), keyword(), moment()}

  # A text about the ground station that comes this much later than the report was held back until one was there again.
  @late_us 1_500_000
  @held_back_us 600_000_000
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

  @doc "What was told of the vehicle before the gateway was started, to be compared with what is found (`Detector.Found`)."
  @spec remember(t(), Detector.Found.t()) :: t()
  def remember(detector, found), do: %{detector | found: found}

  @doc "One step. `known` gives the value that a parameter had; the new values are in the third element."
  @spec observe(t(), observation(), known()) :: {t(), [Event.t()], %{String.t() => term()}}
  def observe(detector, observation, known \\ fn _name -> :error end)

  def observe(%{failsafe: %{pending: %{}}} = detector, observation, known) do
    facts = Map.put(facts(detector), :where, where(observation))
    {failsafe, steps} = Failsafe.due(detector.failsafe, elem(observation, 1), facts)
    {detector, before} = emit(%{detector | failsafe: failsafe}, steps, elem(observation, 1), nil, nil)
    {detector, events, params} = step(detector, observation, known)
    {detector, before ++ events, params}
  end

  # Its session knows nothing of a time before it, and so of no silence that ends.
  def observe(%{lost: :unheard} = detector, {:state, at, boot_ms, _digest} = observation, known) do
    {detector, restored, %{}} = step(detector, {:restored, at, boot_ms}, known)
    {detector, events, params} = step(detector, observation, known)
    {detector, restored ++ events, params}
  end

  def observe(detector, observation, known), do: step(detector, observation, known)

  defp where({:state, _at, _boot_ms, digest}), do: digest[:where]
  defp where({:settle, _at, _boot_ms, where}), do: where
  defp where(_other), do: nil

  # Looked at above.
  defp step(detector, {:settle, _at, _boot_ms, _where}, _known), do: {detector, [], %{}}

  defp step(detector, {:state, at, boot_ms, digest}, _known) do
    {beside, digest} = Map.split(digest, [:where, :voltages])
    where = beside[:where]
    last = detector.last
    now = Map.merge(last, Map.reject(digest, fn {_key, value} -> is_nil(value) end))
    {found, missed} = Detector.Found.steps(detector.found, now, at)
    steps = missed ++ Detector.Changes.events(last, Map.merge(now, beside), detector, at)
    {detector, events} = emit(%{detector | last: now, found: found}, steps, at, boot_ms, where)
    {detector, losses} = Losses.changed(detector, last, now, at)
    {detector, lost} = emit(detector, losses, at, boot_ms, where)

    {failsafe, steps} =
      Failsafe.changed(detector.failsafe, last, Map.put(facts(detector), :where, where), {at, boot_ms, where})

    # PX4's arming checks come as reports.
    reports = detector.reports or is_map_key(now, :fence_check)

    detector = %{
      detector
      | failsafe: failsafe,
        gcs: detector.gcs and not over?(last, now),
        reports: reports
    }

    {detector, failsafes} = emit(detector, steps, at, boot_ms, where)
    {detector, events ++ lost ++ failsafes, %{}}
  end

  defp step(detector, {:text, at, boot_ms, severity, text}, _known) do
    if late?(detector, text, at) do
      {detector, [], %{}}
    else
      data = %{"severity" => severity, "severity_name" => severity_name(severity), "text" => text}
      {detector, said} = emit(detector, [{"statustext", data, []}], at, boot_ms, nil)
      moment = {at, boot_ms, nil}
      {detector, events} = detector |> Detector.Implied.events(text, moment) |> told(moment)
      {detector, said ++ events, %{}}
    end
  end

  defp step(detector, {:said, at, boot_ms, name, values, where}, _known) do
    moment = {at, boot_ms, where}
    {detector, events} = %{detector | reports: true} |> Reported.observe(name, values, moment) |> told(moment)

    {detector, events, %{}}
  end

  # ArduPilot says so too of what it was guided to, which is no item of a mission, and of a mission that it has not.
  defp step(%{last: %{mode: "GUIDED"}} = detector, {:reached, _at, _boot_ms, _seq}, _known),
    do: {detector, [], %{}}

  defp step(%{last: %{mission_total: 0}} = detector, {:reached, _at, _boot_ms, _seq}, _known),
    do: {detector, [], %{}}

  defp step(detector, {:reached, at, boot_ms, seq}, _known) do
    again = match?({^seq, _}, detector.reached) and at - elem(detector.reached, 1) < @reached_again_us
    steps = if again, do: [], else: [{"mission.reached", reached(detector, seq), []}]
    detector = %{detector | reached: {seq, at}, mission: flown_again(detector.mission, seq)}
    {detector, events} = emit(detector, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(detector, {:params, at, boot_ms, values}, known) do
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
    {detector, ended} = detector |> Losses.params(learned, at) |> told({at, boot_ms, nil})
    {detector, events ++ ended, learned}
  end

  defp step(%{lost: false} = detector, {:lost, at, boot_ms, silent_us}, _known) do
    steps = [{"link.lost", %{"silent_s" => Float.round(silent_us / 1_000_000, 1)}, lost: true}]
    {detector, events} = emit(detector, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(%{lost: false} = detector, {:unheard, at, since}, _known) do
    data = %{
      "silent_s" => Float.round(max(at - since, 0) / 1_000_000, 1),
      "found" => true,
      "since" => Json.time(since)
    }

    {detector, events} = emit(detector, [{"link.lost", data, lost: :unheard}], at, nil, nil)
    {detector, events, %{}}
  end

  defp step(%{lost: lost} = detector, {:restored, at, boot_ms}, _known) when lost != false do
    {detector, events} = emit(detector, [{"link.restored", %{}, lost: false}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  # What is known already.
  defp step(detector, {:lost, _at, _boot_ms, _silent_us}, _known), do: {detector, [], %{}}
  defp step(detector, {:restored, _at, _boot_ms}, _known), do: {detector, [], %{}}

  defp step(detector, {:reboot, at, boot_ms}, _known) do
    boot_at = at - boot_ms * 1000

    if detector.boot_at != nil and abs(detector.boot_at - boot_at) < @same_boot_us do
      {detector, [], %{}}
    else
      steps = [
        {"reboot", %{"time_boot_ms" => boot_ms},
         boot_at: boot_at, mission: nil, reached: nil, gcs: false, gcs_reported: nil, reports: false}
      ]

      {failsafe, ended} =
        Failsafe.cleared(detector.failsafe, :all, "reboot", facts(detector), {at, boot_ms, nil})

      detector = Losses.forgotten(%{detector | failsafe: failsafe})
      {detector, events} = emit(detector, ended ++ steps, at, boot_ms, nil)
      {detector, events, %{}}
    end
  end

  defp step(detector, {:collision, at, boot_ms, sign, links}, _known) do
    known = detector.collision != nil and at - detector.collision < @collision_again_us
    links = for side <- links, do: Enum.map(side, &to_string/1)
    steps = if known, do: [], else: [{"collision", %{"sign" => sign, "links" => links}, []}]
    {detector, events} = emit(%{detector | collision: at}, steps, at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(detector, {:report, at, boot_ms, data}, _known) do
    data = Map.put(data, "severity_name", severity_name(data["severity"]))
    {detector, events} = emit(detector, [{"report", data, []}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(detector, {:quiet, at, boot_ms}, _known) do
    {detector, events} = emit(detector, [], at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(detector, {:alarm, at, boot_ms, type, data}, _known) do
    {detector, events} = emit(detector, [{type, data, []}], at, boot_ms, nil)
    {detector, events, %{}}
  end

  defp step(detector, {:streams, at, boot_ms, notices}, _known) do
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

  defp step(detector, {:gcs, at, boot_ms, what, facts}, _known) do
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

  @doc "Whether a breach was told so shortly before `at` that it is the same one."
  @spec fence_told?(t(), integer()) :: boolean()
  def fence_told?(%{fence: nil}, _at), do: false
  def fence_told?(%{fence: told}, at), do: at - told < @fence_again_us

  @doc "What the detector knows of the vehicle: the last digest, and what is wrong with it."
  @spec facts(t()) :: map()
  def facts(detector), do: Map.put(detector.last, :troubles, Losses.troubles(detector))

  # Out of all failsafes, the ground station can be lost anew even if nobody said that it came back.
  defp over?(%{failsafe: true}, %{failsafe: false}), do: true
  defp over?(_last, _now), do: false

  # PX4 holds its texts back until a ground station is there to hear them; what the report told is not told again then.
  defp late?(%{gcs_reported: nil}, _text, _at), do: false

  defp late?(%{gcs_reported: reported}, text, at),
    do: (at - reported) in @late_us..@held_back_us and Texts.gcs(text) == :lost

  defp told({detector, steps}, {at, boot_ms, where}), do: emit(detector, steps, at, boot_ms, where)

  # Each event that is within the budget gets the next number. A change of the detector is made in any case.
  defp emit(detector, steps, at, boot_ms, where) do
    {budget, suppressed} = Detector.Budget.tell(detector.budget, at)
    told = for data <- suppressed, do: {"events.suppressed", data, [], {at, boot_ms, nil}}
    start = Enum.reduce(told, {%{detector | budget: budget}, []}, &number/2)

    {detector, events} =
      Enum.reduce(steps, start, fn step, {detector, events} ->
        {type, data, changes, {at, _, where} = moment} = with_moment(step, {at, boot_ms, where})
        data = if where, do: Map.put(data, "position", where), else: data
        {verdict, budget} = spend(detector.budget, type, data, at)
        step = {if(verdict == :ok, do: type), data, changes, moment}
        number(step, {%{detector | budget: budget}, events})
      end)

    {detector, Enum.reverse(events)}
  end

  defp with_moment({type, data, changes}, moment), do: {type, data, changes, moment}
  defp with_moment(step, _moment), do: step

  defp spend(budget, nil, _data, _at), do: {:ok, budget}
  defp spend(budget, type, data, at), do: Detector.Budget.take(budget, type, data, at)

  defp number({nil, _data, changes, _moment}, {detector, events}), do: {struct!(detector, changes), events}

  defp number({type, data, changes, {at, boot_ms, _where}}, {detector, events}) do
    seq = detector.seq + 1
    event = Event.new(detector.vehicle, type, seq, at, boot_ms, data)
    {struct!(detector, [seq: seq] ++ changes), [event | events]}
  end

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
