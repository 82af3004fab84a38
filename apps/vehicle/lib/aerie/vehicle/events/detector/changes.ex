defmodule Aerie.Vehicle.Events.Detector.Changes do
  @moduledoc """
  The events that follow from the difference of two digests, in the order in which things happen to a vehicle: it changes its
  mode, is armed, takes off … lands, is disarmed.
  """

  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.{Failsafe, Step}

  # A report says who armed or disarmed up to this long before the heartbeat shows it.
  @by_us 5_000_000

  @spec steps(map(), map(), Detector.t(), integer()) :: [Step.t()]
  def steps(last, now, detector, at) do
    mode(last, now) ++
      armed(last, now, detector, at) ++
      takeoff(last, now) ++
      geofence(last, now, detector, at) ++
      Detector.Batteries.steps(now, detector, at) ++
      mission(last, now, detector) ++
      landed(last, now) ++
      landed_mission(last, now, detector) ++
      disarmed(last, now, detector, at)
  end

  # The name of the present mode became known: not a change.
  defp mode(%{mode: from} = last, %{mode: to} = now) when from != to do
    if last[:custom_mode] != nil and last[:custom_mode] == now[:custom_mode] and Modes.unnamed?(from),
      do: [],
      else: [Step.event("mode_change", %{"from" => from, "to" => to})]
  end

  defp mode(_last, _now), do: []

  # A new flight begins: its mission is not completed.
  defp armed(%{armed: false}, %{armed: true} = now, detector, at) do
    data = %{"mode" => now[:mode], "reason" => by(detector, true, at)}
    [Step.event("armed", data, mission_completed: nil, last_item: nil, reached: nil)]
  end

  defp armed(_last, _now, _detector, _at), do: []

  defp disarmed(%{armed: true}, %{armed: false} = now, detector, at),
    do: [Step.event("disarmed", %{"mode" => now[:mode], "reason" => by(detector, false, at)})]

  defp disarmed(_last, _now, _detector, _at), do: []

  defp by(%{armed_by: {reported, armed, reason}}, armed, at) when at - reported <= @by_us, do: reason
  defp by(_detector, _armed, _at), do: nil

  defp takeoff(%{in_air: false}, %{in_air: true} = now), do: [Step.event("takeoff", %{"mode" => now[:mode]})]
  defp takeoff(_last, _now), do: []

  # A fall is not a landing.
  defp landed(%{in_air: true, armed: true}, %{armed: false, aloft: true}), do: []
  defp landed(%{in_air: true}, %{in_air: false} = now), do: [Step.event("landed", %{"mode" => now[:mode]})]
  defp landed(_last, _now), do: []

  defp geofence(%{fence_breach: false}, %{fence_breach: true} = now, _detector, at), do: breached(now, at)

  # Before the first FENCE_STATUS nothing was known, so a breach in it is new, unless a text has reported it.
  defp geofence(last, %{fence_breach: true} = now, detector, at) when not is_map_key(last, :fence_breach) do
    if Detector.fence_reported?(detector, at),
      do: [Step.change(fence_open: {at, now[:fence_breach_type]})],
      else: breached(now, at)
  end

  # PX4 sends no FENCE_STATUS; one of its checks fails instead.
  defp geofence(_last, %{fence_check: {breach, name}, armed: true} = now, %{fence_open: nil} = detector, at)
       when not is_map_key(now, :fence_breach) do
    failsafe = Failsafe.hint(detector.failsafe, at, "fence", name)
    changes = [fence_event_at: at, fence_open: {at, breach}, failsafe: failsafe]

    if Detector.fence_reported?(detector, at),
      do: [Step.change(changes)],
      else: [Step.event("geofence", %{"breach" => breach}, changes)]
  end

  defp geofence(_last, _now, _detector, _at), do: []

  defp breached(now, at) do
    breach = now[:fence_breach_type]
    [Step.event("geofence", %{"breach" => breach}, fence_event_at: at, fence_open: {at, breach})]
  end

  # PX4 calls a mission complete before it begins, and again when it lands later: it is over if an item was reached, the
  # last one is the current one, and it was not over already.
  defp mission(
         %{mission_state: before},
         %{mission_state: "COMPLETE"} = now,
         %{mission_completed: nil} = detector
       )
       when before != "COMPLETE" do
    if detector.reached != nil and last_item?(now) do
      data = %{"seq" => now[:mission_seq], "total" => now[:mission_total], "before" => before}
      [Step.event("mission.completed", data, mission_completed: now.mission_seq)]
    else
      []
    end
  end

  # The current item is an earlier one again, or the plan has another length: a mission begins.
  defp mission(last, now, %{mission_completed: completed}) when completed != nil do
    begun? = now[:mission_state] not in ["COMPLETE", "NO_MISSION"]
    back? = is_integer(completed) and begun? and is_map_key(now, :mission_seq) and now.mission_seq < completed

    if back? or last[:mission_total] != now[:mission_total],
      do: [Step.change(mission_completed: nil, reached: nil)],
      else: []
  end

  defp mission(_last, _now, _detector), do: []

  # ArduPilot does not say that a mission is over that ends with the landing. It resets the mission when it disarms, a moment
  # before the heartbeat shows that. Its total leaves out the home position, item 0, so the last item is number `total`. The one
  # before is the last that the vehicle executes if a command for the camera or the like follows: then it was reached itself.
  defp landed_mission(
         _last,
         %{mode: "AUTO", armed: true, mission_seq: seq, mission_total: total} = now,
         detector
       )
       when seq > 0 do
    last = if last_item?(now), do: {seq, total}
    if last == detector.last_item, do: [], else: [Step.change(last_item: last)]
  end

  defp landed_mission(
         %{armed: true, in_air: false},
         %{armed: false, mode: "AUTO"},
         %{mission_completed: nil, last_item: {seq, total}, reached: {reached, _at}}
       )
       when reached >= total - 1 do
    data = %{"seq" => seq, "total" => total, "inferred" => true}
    [Step.event("mission.completed", data, mission_completed: seq, last_item: nil)]
  end

  defp landed_mission(_last, _now, _detector), do: []

  defp last_item?(%{mission_seq: seq, mission_total: total}), do: seq >= total - 1
  defp last_item?(_unknown), do: false
end
