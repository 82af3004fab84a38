defmodule Aerie.Vehicle.Events.Detector.Losses do
  @moduledoc """
  What a vehicle loses and gets back: remote control, GNSS, its position, the inside of its fence; and its kill switch.
  Several sources may say the same; each loss is reported once, and its end with its duration. The state shows an end
  as well, because the message that tells it may be lost.

  GNSS counts as lost only while the vehicle is armed, the position only in the air: on the ground they come and go.
  """

  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Failsafe, Step}

  # For as long as this the state may be older than the message that something was lost.
  @settled_us 5_000_000

  @doc "The events that follow from the difference of two digests."
  @spec changed(Detector.t(), map(), map(), Step.moment()) :: {Detector.t(), [Step.t()]}
  def changed(detector, last, now, %{at: at} = moment) do
    parts = [&gps/4, &position/4, &receiver/4, &fence_end/4, &kill_end/4]

    Enum.reduce(parts, fence_begin(detector, last, now, moment), fn part, {detector, steps} ->
      {detector, more} = part.(detector, last, now, at)
      {detector, steps ++ more}
    end)
  end

  defp fence_begin(detector, last, %{fence_breach: true} = now, moment) do
    if last[:fence_breach] == true,
      do: {detector, []},
      else: fence_acts(detector, now[:fence_breach_type], nil, moment)
  end

  defp fence_begin(detector, _last, _now, _moment), do: {detector, []}

  @doc "A fence is broken: if the vehicle acts on it (FENCE_ACTION), that is a failsafe. PX4 reports it as one itself."
  @spec fence_acts(Detector.t(), String.t() | nil, String.t() | nil, Step.moment()) ::
          {Detector.t(), [Step.t()]}
  def fence_acts(%{reports: true} = detector, _breach, _text, _moment), do: {detector, []}

  def fence_acts(detector, breach, text, moment) do
    facts = %{by: :fence, type: "fence", reason: breach || "fence", text: text, needs_action: true}
    {failsafe, steps} = Failsafe.start(detector.failsafe, facts, Detector.facts(detector), moment)
    {%{detector | failsafe: failsafe}, steps}
  end

  defp gps(%{gps_lost: nil} = detector, %{gps: "OK"}, %{gps: fix, armed: true}, at) when fix != "OK",
    do: {%{hint(detector, at, "gps") | gps_lost: at}, [Step.event("gps.lost", %{"fix_name" => fix})]}

  defp gps(%{gps_lost: since} = detector, _last, %{gps: "OK"}, at) when since != nil,
    do: {%{detector | gps_lost: nil}, [Step.event("gps.restored", duration(since, at))]}

  defp gps(detector, _last, _now, _at), do: {detector, []}

  defp position(%{position_lost: nil} = detector, %{position: true}, %{position: false, in_air: true}, at),
    do: {%{hint(detector, at, "position") | position_lost: at}, [Step.event("position.lost")]}

  defp position(%{position_lost: since} = detector, _last, %{position: true}, at) when since != nil,
    do: {%{detector | position_lost: nil}, [Step.event("position.restored", duration(since, at))]}

  defp position(detector, _last, _now, _at), do: {detector, []}

  defp receiver(detector, %{rc_receiver: true}, %{rc_receiver: false}, at), do: rc(detector, :lost, nil, at)
  defp receiver(detector, %{rc_receiver: false}, %{rc_receiver: true}, at), do: rc(detector, :back, nil, at)

  defp receiver(%{rc_lost: since} = detector, _last, %{rc_receiver: true}, at)
       when is_integer(since) and at - since > @settled_us,
       do: rc(detector, :back, nil, at)

  defp receiver(detector, _last, _now, _at), do: {detector, []}

  defp fence_end(%{fence_open: {_since, _breach}} = detector, last, now, at) do
    inside? =
      now[:fence_breach] == false or (last[:fence_check] not in [nil, false] and now[:fence_check] == false)

    # Nothing else may show the end of a breach that only a text told of.
    told_over? = not Detector.fence_shown?(now) and last[:armed] == true and now[:armed] == false
    if inside? or told_over?, do: fence_over(detector, at), else: {detector, []}
  end

  defp fence_end(detector, _last, _now, _at), do: {detector, []}

  defp fence_over(%{fence_open: {since, breach}} = detector, at) do
    data = Map.put(duration(since, at), "breach", breach)
    {failsafe, ended} = fence_failsafe_over(detector, at)

    {%{detector | fence_open: nil, failsafe: failsafe}, [Step.event("geofence.cleared", data) | ended]}
  end

  # PX4 goes on with it, and says when it is over.
  defp fence_failsafe_over(%{reports: true} = detector, _at), do: {detector.failsafe, []}

  defp fence_failsafe_over(detector, at) do
    moment = %{at: at, boot_ms: nil, where: nil, received: at}
    Failsafe.clear(detector.failsafe, {:type, "fence"}, "fence", Detector.facts(detector), moment)
  end

  @doc "Parameters with new values: of a fence that is switched off, ArduPilot sends no FENCE_STATUS."
  @spec params(Detector.t(), %{String.t() => term()}, integer()) :: {Detector.t(), [Step.t()]}
  def params(detector, %{"FENCE_ENABLE" => off}, at) when off == 0 do
    # Switched on again outside, it is broken again.
    last = if detector.last[:fence_breach], do: %{detector.last | fence_breach: false}, else: detector.last
    detector = %{detector | last: last}
    if detector.fence_open, do: fence_over(detector, at), else: {detector, []}
  end

  def params(detector, _values, _at), do: {detector, []}

  @doc "The remote control is lost or back, as a text, a report or the receiver's state says."
  @spec rc(Detector.t(), :lost | :back | nil, String.t() | nil, integer()) ::
          {Detector.t(), [Step.t()]}
  def rc(%{rc_lost: nil} = detector, :lost, text, at),
    do: {%{detector | rc_lost: at}, [Step.event("rc.lost", %{"text" => text})]}

  def rc(%{rc_lost: since} = detector, :back, text, at) when since != nil do
    {%{detector | rc_lost: nil}, [Step.event("rc.restored", Map.put(duration(since, at), "text", text))]}
  end

  def rc(detector, _known, _text, _at), do: {detector, []}

  # No firmware arms or takes off with the switch engaged. PX4's heartbeat shows it as well.
  defp kill_end(%{killed: since} = detector, last, now, at) when since != nil do
    begins? = &(last[&1] == false and now[&1] == true)
    shown? = last[:system_status] == "FLIGHT_TERMINATION" and now[:system_status] != "FLIGHT_TERMINATION"

    if begins?.(:armed) or begins?.(:in_air) or shown?,
      do: kill(detector, false, nil, at),
      else: {detector, []}
  end

  defp kill_end(detector, _last, _now, _at), do: {detector, []}

  @doc "The kill switch is engaged or released; nil: nothing is said of it."
  @spec kill(Detector.t(), boolean() | nil, String.t() | nil, integer()) :: {Detector.t(), [Step.t()]}
  def kill(%{killed: nil} = detector, true, text, at),
    do: {%{detector | killed: at}, [Step.event("kill_switch.engaged", %{"text" => text})]}

  def kill(%{killed: since} = detector, false, text, _at) when since != nil,
    do: {%{detector | killed: nil}, [Step.event("kill_switch.released", %{"text" => text})]}

  def kill(detector, _known, _text, _at), do: {detector, []}

  @doc "The vehicle's present faults that may cause a failsafe, the most likely cause first."
  @spec troubles(Detector.t()) :: [String.t()]
  def troubles(detector) do
    for {type, true} <- [
          {"fence", detector.fence_open != nil},
          {"gps", detector.gps_lost != nil},
          {"position", detector.position_lost != nil},
          {"rc", detector.rc_lost != nil},
          {"gcs", detector.gcs_failsafe},
          {"battery", Enum.any?(detector.battery, &match?({_key, {:critical, _since}}, &1))}
        ],
        do: type
  end

  @doc "After a reboot none of this is known."
  @spec forget(Detector.t()) :: Detector.t()
  def forget(detector),
    do: %{detector | gps_lost: nil, position_lost: nil, rc_lost: nil, fence_open: nil, killed: nil}

  defp hint(detector, at, type),
    do: %{detector | failsafe: Failsafe.hint(detector.failsafe, at, type, type)}

  defp duration(since, at), do: %{"duration" => Step.seconds(since, at)}
end
