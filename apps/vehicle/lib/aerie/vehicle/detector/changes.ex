defmodule Aerie.Vehicle.Detector.Changes do
  @moduledoc """
  What the difference of two digests means: steps `{event type, data, changes of the detector}` in the order in which
  things happen to a vehicle (it changes its mode, is armed, takes off … lands, is disarmed).

  A step whose type is nil changes the detector without an event.
  """

  alias Aerie.Vehicle.Detector

  @type step :: {String.t() | nil, map(), keyword()}

  @spec events(map(), map(), Detector.t(), integer()) :: [step()]
  def events(last, now, detector, at) do
    mode(last, now) ++
      armed(last, now) ++
      takeoff(last, now) ++
      failsafe(last, now, detector, at) ++
      geofence(last, now, detector, at) ++
      Detector.Batteries.events(now, detector) ++
      mission(last, now, detector) ++
      landed(last, now) ++
      disarmed(last, now)
  end

  defp mode(%{mode: from}, %{mode: to}) when from != to,
    do: [{"mode_change", %{"from" => from, "to" => to}, []}]

  defp mode(_last, _now), do: []

  # A new flight: its mission is one that has not been completed.
  defp armed(%{armed: false}, %{armed: true} = now) do
    [{"armed", %{"mode" => now[:mode]}, mission: nil, reached: nil}]
  end

  defp armed(_last, _now), do: []

  defp disarmed(%{armed: true}, %{armed: false} = now), do: [{"disarmed", %{"mode" => now[:mode]}, []}]
  defp disarmed(_last, _now), do: []

  defp takeoff(%{in_air: false}, %{in_air: true} = now), do: [{"takeoff", %{"mode" => now[:mode]}, []}]
  defp takeoff(_last, _now), do: []

  defp landed(%{in_air: true}, %{in_air: false} = now), do: [{"landed", %{"mode" => now[:mode]}, []}]
  defp landed(_last, _now), do: []

  defp failsafe(%{failsafe: false}, %{failsafe: true} = now, detector, at) do
    {reason, text} = Detector.reason(detector, at)
    data = %{"reason" => reason, "text" => text, "mode" => now[:mode], "system_status" => now[:system_status]}
    [{"failsafe", data, []}]
  end

  # Out of the failsafe, the ground station can be lost anew even if nobody said that it came back.
  defp failsafe(%{failsafe: true}, %{failsafe: false}, _detector, _at), do: [{nil, %{}, gcs: false}]
  defp failsafe(_last, _now, _detector, _at), do: []

  defp geofence(%{fence_breach: false}, %{fence_breach: true} = now, _detector, at), do: breached(now, at)

  # Before the first FENCE_STATUS there was no telling, so a breach that it begins with is news, unless a text told.
  defp geofence(last, %{fence_breach: true} = now, detector, at) when not is_map_key(last, :fence_breach) do
    if Detector.fence_told?(detector, at), do: [], else: breached(now, at)
  end

  defp geofence(_last, _now, _detector, _at), do: []

  defp breached(now, at), do: [{"geofence", %{"breach" => now[:fence_breach_type]}, fence: at}]

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

  defp at_end?(%{mission_seq: seq, mission_total: total}), do: seq >= total - 1
  defp at_end?(_unknown), do: false
end
