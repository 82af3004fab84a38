defmodule Aerie.Vehicle.Events.Detector do
  @moduledoc """
  Detects events in what is observed of a vehicle (`Detector.Observation`). A pure value:
  `observe(detector, observation, known) -> {detector, events, params}`.

  It compares what it is shown with what it was shown last, so the same observation twice (after a crash of the session, by a
  second link) gives no second event. Its whole state is one small term that is committed together with the events.

  A digest (`Detector.Digest`) is the part of the state that events are about. The first one is where the vehicle is found,
  not an event. Exceptions are a low battery, a failsafe, which is marked as found, and what changed while the gateway was not
  running (`Detector.OfflineChanges`).
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.{Event, Options}
  alias Aerie.Vehicle.Events.Detector.{Batteries, Budget, Changes, Failsafe, Losses}
  alias Aerie.Vehicle.Events.Detector.{Observation, OfflineChanges, StatusTexts, Step, TextConditions}
  alias Aerie.Vehicle.Events.Detector.Failsafe.Px4Reports

  defstruct [
    :vehicle,
    :battery_low,
    :battery_critical,
    seq: 0,
    done: 0,
    last: %{},
    battery: %{},
    failsafe: %Failsafe{},
    gcs_failsafe: false,
    gcs_lost: nil,
    gcs_reported_at: nil,
    reports: false,
    armed_by: nil,
    rc_lost: nil,
    gps_lost: nil,
    position_lost: nil,
    killed: nil,
    fence_event_at: nil,
    fence_open: nil,
    mission_completed: nil,
    last_item: nil,
    reached: nil,
    lost: false,
    boot_at: nil,
    collision_at: nil,
    published: nil,
    conditions: [],
    budget: Budget.new()
  ]

  @typedoc """
  - `seq`: number of the last event; `done`: number of the last inbox entry
  - `last`: the last digest; `published`: what was published before the gateway was started and is not compared yet
  - `gcs_failsafe`, `lost`: that event came last, not the one that ends it; `lost` is `:unheard` if the gateway
    never heard the vehicle
  - `rc_lost`, `gps_lost`, `position_lost`, `gcs_lost`, `killed`: since when; `fence_open`: since when, and which breach
  - `conditions`: what is wrong with the vehicle now
  - `gcs_reported_at`, `fence_event_at`, `collision_at`: when that was last reported
  - `reports`: the vehicle sends reports; `armed_by`: what the last one said
  - `mission_completed`: its last item; `last_item`: the current item is the last one; `reached`: the last one reached
  """
  @type t :: %__MODULE__{
          vehicle: String.t(),
          battery_low: float(),
          battery_critical: float(),
          seq: non_neg_integer(),
          done: non_neg_integer(),
          last: map(),
          battery: Batteries.levels(),
          failsafe: Failsafe.t(),
          gcs_failsafe: boolean(),
          gcs_lost: integer() | nil,
          gcs_reported_at: integer() | nil,
          reports: boolean(),
          armed_by: {integer(), armed :: boolean(), reason :: term()} | nil,
          rc_lost: integer() | nil,
          gps_lost: integer() | nil,
          position_lost: integer() | nil,
          killed: integer() | nil,
          fence_event_at: integer() | nil,
          fence_open: {integer(), String.t() | nil} | nil,
          mission_completed: non_neg_integer() | :unknown | nil,
          last_item: {seq :: non_neg_integer(), total :: non_neg_integer()} | nil,
          reached: {non_neg_integer(), integer()} | nil,
          lost: boolean() | :unheard,
          boot_at: integer() | nil,
          collision_at: integer() | nil,
          published: OfflineChanges.t(),
          conditions: [condition()],
          budget: Budget.t()
        }

  @type known :: (String.t() -> {:ok, term()} | :error)

  # A text about the ground station that comes this much later than the report was held back until one was there again.
  @late_us 1_500_000
  @held_back_us 600_000_000
  # PX4 repeats once a second that it has reached an item.
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

  @doc "Sets the state published before the gateway was started, to be compared with what is observed (`Detector.OfflineChanges`)."
  @spec remember(t(), OfflineChanges.t()) :: t()
  def remember(detector, published), do: %{detector | published: published}

  @doc "One step. `known` returns the last known value of a parameter; the new values are in the third element."
  @spec observe(t(), Observation.t(), known()) :: {t(), [Event.t()], %{String.t() => term()}}
  def observe(detector, observation, known \\ fn _name -> :error end) do
    {detector, events, params} = observed(detector, observation, known)
    {%{detector | conditions: conditions(detector)}, events, params}
  end

  defp observed(%{failsafe: %{pending: %{}}} = detector, %Observation{received: now} = observation, known) do
    facts = Map.put(facts(detector), :where, where(observation))
    {failsafe, steps} = Failsafe.due(detector.failsafe, now, facts)
    moment = %{at: now, boot_ms: nil, where: nil, received: now}
    {detector, before} = Step.emit(%{detector | failsafe: failsafe}, steps, moment)
    {detector, events, params} = step(detector, observation, known)
    {detector, before ++ events, params}
  end

  # The session, which was started later, does not know of the silence and cannot tell that it ends.
  defp observed(%{lost: :unheard} = detector, %Observation{kind: :state, at: at} = observation, known) do
    {detector, restored, %{}} = step(detector, Observation.new(:restored, at, observation.boot_ms), known)
    {detector, events, params} = step(detector, observation, known)
    {detector, restored ++ events, params}
  end

  defp observed(detector, %Observation{} = observation, known), do: step(detector, observation, known)

  defp where(%{kind: :state, data: digest}), do: digest[:where]
  defp where(%{kind: :settle, data: where}), do: where
  defp where(_other), do: nil

  defp step(detector, %{kind: :params, data: values} = observation, known) do
    {steps, learned} =
      Enum.reduce(values, {[], %{}}, fn {name, value, index}, {steps, learned} ->
        before = if is_map_key(learned, name), do: Map.fetch(learned, name), else: known.(name)

        case before do
          {:ok, ^value} -> {steps, learned}
          :error -> {steps, Map.put(learned, name, value)}
          {:ok, old} -> {[param_changed(name, old, value, index) | steps], Map.put(learned, name, value)}
        end
      end)

    {detector, events} = emit({detector, Enum.reverse(steps)}, observation)
    {detector, ended} = detector |> Losses.params(learned, observation.at) |> emit(observation)
    {detector, events ++ ended, learned}
  end

  defp step(detector, %{kind: :state, at: at} = observation, _known) do
    {beside, digest} = Map.split(observation.data, [:where, :voltages, :aloft])
    last = detector.last
    now = last |> Map.merge(Map.reject(digest, fn {_key, value} -> is_nil(value) end)) |> fence_off(last)
    {published, missed} = OfflineChanges.steps(detector.published, now, at)
    steps = missed ++ Changes.steps(last, Map.merge(now, beside), detector, at)
    {detector, events} = emit({%{detector | last: now, published: published}, steps}, observation)
    {detector, losses} = detector |> Losses.changed(last, now, moment(observation)) |> emit(observation)

    facts = Map.put(facts(detector), :where, beside[:where])
    {failsafe, steps} = Failsafe.changed(detector.failsafe, last, facts, moment(observation))

    detector = %{
      detector
      | failsafe: failsafe,
        gcs_failsafe: detector.gcs_failsafe and not failsafes_over?(last, now),
        # PX4's arming checks come as reports.
        reports: detector.reports or is_map_key(now, :fence_check)
    }

    {detector, failsafes} = emit({detector, steps}, observation)
    {detector, events ++ losses ++ failsafes, %{}}
  end

  defp step(detector, %{kind: :text, data: %{text: text} = data} = observation, _known) do
    if held_back?(detector, text, observation.at) do
      {detector, [], %{}}
    else
      {detector, texts} = emit({detector, [statustext(data)]}, observation)
      {detector, events} = detector |> TextConditions.steps(text, moment(observation)) |> emit(observation)
      {detector, texts ++ events, %{}}
    end
  end

  defp step(detector, %{kind: kind} = observation, _known) do
    case steps(kind, detector, observation) do
      :ignore ->
        {detector, [], %{}}

      result ->
        {detector, events} = emit(result, observation)
        {detector, events, %{}}
    end
  end

  defp steps(:px4_report, detector, %{data: %{name: name, values: values}} = observation),
    do: Px4Reports.steps(%{detector | reports: true}, name, values, moment(observation))

  defp steps(:part_text, detector, %{data: %{component: component} = data}),
    do: {detector, [statustext(data, %{"component" => component})]}

  # Handled by `observe/3`.
  defp steps(:settle, _detector, _observation), do: :ignore
  defp steps(:quiet, detector, _observation), do: {detector, []}

  # ArduPilot also sends MISSION_ITEM_REACHED for targets of guided mode, and for a mission without items.
  defp steps(:reached, %{last: %{mode: "GUIDED"}}, _observation), do: :ignore
  defp steps(:reached, %{last: %{mission_total: 0}}, _observation), do: :ignore

  defp steps(:reached, detector, %{at: at, data: seq}) do
    again? = match?({^seq, before} when at - before < @reached_again_us, detector.reached)
    completed = completed(detector.mission_completed, seq)

    {%{detector | reached: {seq, at}, mission_completed: completed},
     if(again?, do: [], else: [Step.event("mission.reached", reached(detector, seq))])}
  end

  defp steps(:lost, %{lost: false} = detector, %{data: silent_us}),
    do: {detector, [Step.event("link.lost", %{"silent_s" => Step.seconds(0, silent_us)}, lost: true)]}

  defp steps(:unheard, %{lost: false} = detector, %{at: at, data: since}) do
    data = %{"silent_s" => Step.seconds(since, at), "found" => true, "since" => Json.time(since)}
    {detector, [Step.event("link.lost", data, lost: :unheard)]}
  end

  defp steps(:restored, %{lost: lost} = detector, _observation) when lost != false,
    do: {detector, [Step.event("link.restored", %{}, lost: false)]}

  # Already reported.
  defp steps(kind, _detector, _observation) when kind in [:lost, :unheard, :restored], do: :ignore

  defp steps(:reboot, detector, %{at: at, boot_ms: boot_ms} = observation) do
    boot_at = at - boot_ms * 1000

    if detector.boot_at != nil and abs(detector.boot_at - boot_at) < @same_boot_us do
      :ignore
    else
      reset = [
        boot_at: boot_at,
        mission_completed: nil,
        reached: nil,
        gcs_failsafe: false,
        gcs_reported_at: nil,
        reports: false
      ]

      {failsafe, ended} =
        Failsafe.clear(detector.failsafe, :all, "reboot", facts(detector), moment(observation))

      {Losses.forget(%{detector | failsafe: failsafe}),
       ended ++ [Step.event("reboot", %{"time_boot_ms" => boot_ms}, reset)]}
    end
  end

  defp steps(:collision, detector, %{at: at, data: %{sign: sign, links: links}}) do
    again? = detector.collision_at != nil and at - detector.collision_at < @collision_again_us
    links = for side <- links, do: Enum.map(side, &to_string/1)
    steps = if again?, do: [], else: [Step.event("collision", %{"sign" => sign, "links" => links})]
    {%{detector | collision_at: at}, steps}
  end

  defp steps(:report, detector, %{data: data}) do
    data = Map.put(data, "severity_name", severity_name(data["severity"]))
    {detector, [Step.event("report", data)]}
  end

  defp steps(:external, detector, %{data: %{type: type, data: data}}),
    do: {detector, [Step.event(type, data)]}

  defp steps(:published, detector, %{at: at, data: published}) do
    {published, missed} = OfflineChanges.steps(published, detector.last, at)
    {%{detector | published: published}, missed}
  end

  defp steps(:streams, detector, %{data: notices}) do
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

    {detector, [Step.event("stream.contested", %{"messages" => messages})]}
  end

  defp steps(:gcs, %{gcs_lost: nil} = detector, %{at: at, data: {:lost, facts}}) do
    data = %{
      "system" => facts.system,
      "timeout_s" => facts.timeout_s,
      "failsafe_enabled" => facts.enabled
    }

    {detector, [Step.event("gcs.lost", data, gcs_lost: at)]}
  end

  defp steps(:gcs, %{gcs_lost: since} = detector, %{data: {:back, facts}}) when since != nil,
    do: {detector, [Step.event("gcs.restored", %{"system" => facts.system}, gcs_lost: nil)]}

  defp steps(:gcs, detector, _already_reported), do: {detector, []}

  defp emit({detector, steps}, observation), do: Step.emit(detector, steps, moment(observation))

  defp moment(%{at: at, boot_ms: boot_ms, received: received} = observation),
    do: %{at: at, boot_ms: boot_ms, where: place(observation), received: received}

  defp place(%{kind: :state, data: digest}), do: digest[:where]
  defp place(%{kind: :px4_report, data: %{where: where}}), do: where
  defp place(_other), do: nil

  @doc "Whether a breach was reported so shortly before `at` that it is the same one."
  @spec fence_reported?(t(), integer()) :: boolean()
  def fence_reported?(%{fence_event_at: nil}, _at), do: false
  def fence_reported?(%{fence_event_at: reported}, at), do: at - reported < @fence_again_us

  @doc "Whether a message that shows the vehicle's fence was heard: FENCE_STATUS, or PX4's checks."
  @spec fence_shown?(map()) :: boolean()
  def fence_shown?(digest), do: is_map_key(digest, :fence_breach) or is_map_key(digest, :fence_check)

  @typedoc """
  Something that holds: the event that began it (`Aerie.Vehicle.Event.Types`), which of several (of a vehicle's batteries, of its failsafes; nil if it
  is the only one), since when, and data as of that event.
  """
  @type condition :: %{type: String.t(), subject: term(), since: integer(), data: map()}

  # Each alarm of `Aerie.Vehicle.Event.Types` that events begin is here while it holds, so its end needs no event.
  defp conditions(%{last: last} = detector) do
    {fence, breach} = detector.fence_open || {nil, nil}

    single =
      for {type, since, holds?, data} <- [
            {"geofence", fence, true, %{"breach" => breach}},
            {"rc.lost", detector.rc_lost, true, %{}},
            {"gps.lost", detector.gps_lost, last[:armed] != false, %{}},
            {"position.lost", detector.position_lost, last[:in_air] != false, %{}},
            {"kill_switch.engaged", detector.killed, true, %{}},
            {"gcs.lost", detector.gcs_lost, true, %{}}
          ],
          since != nil and holds?,
          do: %{type: type, subject: nil, since: since, data: data}

    Batteries.conditions(detector) ++ Failsafe.conditions(detector.failsafe, last) ++ single
  end

  @doc "The detector's knowledge of the vehicle: the last digest, and its faults (`:troubles`)."
  @spec facts(t()) :: map()
  def facts(detector), do: Map.put(detector.last, :troubles, Losses.troubles(detector))

  # ArduPilot sends no FENCE_STATUS of a fence that is off. On again, it may be broken again.
  defp fence_off(%{fence_on: false, fence_breach: true} = now, %{fence_on: true}),
    do: %{now | fence_breach: false}

  defp fence_off(now, _last), do: now

  # After all failsafes are over, the ground station can be lost again even if no message said that it came back.
  defp failsafes_over?(%{failsafe: true}, %{failsafe: false}), do: true
  defp failsafes_over?(_last, _now), do: false

  # PX4 holds its texts back until a ground station is there; what the report has said is not reported again then.
  defp held_back?(%{gcs_reported_at: nil}, _text, _at), do: false

  defp held_back?(%{gcs_reported_at: reported}, text, at),
    do: (at - reported) in @late_us..@held_back_us and StatusTexts.gcs(text) == :lost

  defp reached(%{last: %{mission_total: total}}, seq), do: %{"seq" => seq, "total" => total}
  defp reached(_detector, seq), do: %{"seq" => seq}

  # An earlier item was reached after the end: the mission is flown again.
  defp completed(last, seq) when is_integer(last) and seq < last, do: nil
  defp completed(last, _seq), do: last

  defp statustext(%{severity: severity, text: text}, more \\ %{}) do
    data = %{"severity" => severity, "severity_name" => severity_name(severity), "text" => text}
    Step.event("statustext", Map.merge(data, more))
  end

  defp param_changed(name, old, value, index),
    do: Step.event("param_changed", %{"name" => name, "from" => old, "to" => value, "index" => index})

  defp round_hz(nil), do: nil
  defp round_hz(hz), do: Float.round(hz * 1.0, 2)

  defp severity_name(severity), do: MavCodec.Enums.MavSeverity.label(severity) || "SEVERITY(#{severity})"
end
