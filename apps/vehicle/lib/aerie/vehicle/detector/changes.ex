defmodule Aerie.Vehicle.Detector.Changes do
  @moduledoc """
  What the difference of two digests means: steps `{event type, data, changes of the detector}` in the order in which
  things happen to a vehicle (it changes its mode, is armed, takes off … lands, is disarmed).

  A step whose type is nil changes the detector without an event.
  """

  alias Aerie.Vehicle.{Detector, Modes}
  alias Aerie.Vehicle.Detector.Failsafe

  # A report says who armed or disarmed up to this long before the heartbeat shows it.
  @by_us 5_000_000

  @spec events(map(), map(), Detector.t(), integer()) :: [Detector.step()]
  def events(last, now, detector, at) do
    mode(last, now) ++
      armed(last, now, detector, at) ++
      takeoff(last, now) ++
      geofence(last, now, detector, at) ++
      Detector.Batteries.events(now, detector) ++
      mission(last, now, detector) ++
      landed(last, now) ++
      landed_mission(last, now, detector) ++
      disarmed(last, now, detector, at)
  end

  # The same mode, whose name is known only now, is no change.
  defp mode(%{mode: from} = last, %{mode: to} = now) when from != to do
    if last[:custom_mode] != nil and last[:custom_mode] == now[:custom_mode] and Modes.unnamed?(from),
      do: [],
      else: [{"mode_change", %{"from" => from, "to" => to}, []}]
  end

  defp mode(_last, _now), do: []

  # A new flight: its mission is one that has not been completed.
  defp armed(%{armed: false}, %{armed: true} = now, detector, at) do
    [
      {"armed", %{"mode" => now[:mode], "reason" => by(detector, true, at)},
       mission: nil, at_last: nil, reached: nil}
    ]
  end

  defp armed(_last, _now, _detector, _at), do: []

  defp disarmed(%{armed: true}, %{armed: false} = now, detector, at),
    do: [{"disarmed", %{"mode" => now[:mode], "reason" => by(detector, false, at)}, []}]

  defp disarmed(_last, _now, _detector, _at), do: []

  # PX4 says it up to a second before its heartbeat shows it.
  defp by(%{armed_by: {said, armed, reason}}, armed, at) when at - said <= @by_us, do: reason
  defp by(_detector, _armed, _at), do: nil

  defp takeoff(%{in_air: false}, %{in_air: true} = now), do: [{"takeoff", %{"mode" => now[:mode]}, []}]
  defp takeoff(_last, _now), do: []

  defp landed(%{in_air: true}, %{in_air: false} = now), do: [{"landed", %{"mode" => now[:mode]}, []}]
  defp landed(_last, _now), do: []

  defp geofence(%{fence_breach: false}, %{fence_breach: true} = now, _detector, at), do: breached(now, at)

  # Before the first FENCE_STATUS there was no telling, so a breach that it begins with is news, unless a text told.
  defp geofence(last, %{fence_breach: true} = now, detector, at) when not is_map_key(last, :fence_breach) do
    if Detector.fence_told?(detector, at),
      do: [{nil, %{}, fence_open: {at, now[:fence_breach_type]}}],
      else: breached(now, at)
  end

  # PX4 has no FENCE_STATUS, but a check that fails.
  defp geofence(_last, %{fence_check: {breach, name}, armed: true} = now, %{fence_open: nil} = detector, at)
       when not is_map_key(now, :fence_breach) do
    failsafe = Failsafe.said(detector.failsafe, at, "fence", name)
    told = [fence: at, fence_open: {at, breach}, failsafe: failsafe]

    if Detector.fence_told?(detector, at),
      do: [{nil, %{}, told}],
      else: [{"geofence", %{"breach" => breach}, told}]
  end

  defp geofence(_last, _now, _detector, _at), do: []

  defp breached(now, at) do
    breach = now[:fence_breach_type]
    [{"geofence", %{"breach" => breach}, fence: at, fence_open: {at, breach}}]
  end

  # PX4 calls a mission complete before it began and again when it lands later: it is over when it was active, the last
  # item is the current one, and it was not over already.
  defp mission(%{mission_state: was} = last, %{mission_state: "COMPLETE"} = now, %{mission: nil} = detector)
       when was != "COMPLETE" do
    if detector.reached != nil and at_end?(now) do
      data = %{"seq" => now[:mission_seq], "total" => now[:mission_total], "before" => last.mission_state}
      [{"mission.completed", data, mission: now.mission_seq}]
    else
      []
    end
  end

  # The current item went back behind the end, or the plan has another length: a mission begins.
  defp mission(last, now, %{mission: completed}) when completed != nil do
    begun = now[:mission_state] not in ["COMPLETE", "NO_MISSION"]
    back = is_integer(completed) and begun and is_map_key(now, :mission_seq) and now.mission_seq < completed

    if back or last[:mission_total] != now[:mission_total],
      do: [{nil, %{}, mission: nil, reached: nil}],
      else: []
  end

  defp mission(_last, _now, _detector), do: []

  # ArduPilot says nothing of a mission that ends with its landing. It begins anew with the disarming, a moment before the
  # heartbeat shows that.
  defp landed_mission(
         _last,
         %{mode: "AUTO", armed: true, mission_seq: seq, mission_total: total} = now,
         detector
       )
       when seq > 0 do
    last = if at_end?(now), do: {seq, total}
    if last == detector.at_last, do: [], else: [{nil, %{}, at_last: last}]
  end

  defp landed_mission(
         %{armed: true},
         %{armed: false, mode: "AUTO"} = now,
         %{mission: nil, at_last: {seq, total}} = d
       ) do
    if now[:in_air] != true and d.reached != nil and elem(d.reached, 0) >= seq - 1 do
      data = %{"seq" => seq, "total" => total, "inferred" => true}
      [{"mission.completed", data, mission: seq, at_last: nil}]
    else
      []
    end
  end

  defp landed_mission(_last, _now, _detector), do: []

  defp at_end?(%{mission_seq: seq, mission_total: total}), do: seq >= total - 1
  defp at_end?(_unknown), do: false
end
