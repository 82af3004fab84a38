defmodule Aerie.Vehicle.Detector.Losses do
  @moduledoc """
  What a vehicle loses and gets back: remote control, GNSS, its position, the inside of its fence; and its kill switch. A part
  of the detector. Several sources may say the same; each loss is told once, and its end with the time that it lasted.

  GNSS is missed of an armed vehicle only, the position of one in the air: on the ground they come and go.
  """

  alias Aerie.Vehicle.Detector
  alias Aerie.Vehicle.Detector.Failsafe

  @doc "The difference of two digests, as steps and changes of the detector."
  @spec changed(Detector.t(), map(), map(), integer()) :: {Detector.t(), [Detector.step()]}
  def changed(detector, last, now, at) do
    Enum.reduce([&gps/4, &position/4, &receiver/4, &fence_end/4], {detector, []}, fn part,
                                                                                     {detector, steps} ->
      {detector, more} = part.(detector, last, now, at)
      {detector, steps ++ more}
    end)
  end

  defp gps(%{gps_lost: nil} = detector, %{gps: "OK"}, %{gps: fix, armed: true}, at) when fix != "OK",
    do: {%{said(detector, at, "gps") | gps_lost: at}, [{"gps.lost", %{"fix_name" => fix}, []}]}

  defp gps(%{gps_lost: since} = detector, _last, %{gps: "OK"}, at) when since != nil,
    do: {%{detector | gps_lost: nil}, [{"gps.restored", %{"duration" => lasted(since, at)}, []}]}

  defp gps(detector, _last, _now, _at), do: {detector, []}

  defp position(%{position_lost: nil} = detector, %{position: true}, %{position: false, in_air: true}, at),
    do: {%{said(detector, at, "position") | position_lost: at}, [{"position.lost", %{}, []}]}

  defp position(%{position_lost: since} = detector, _last, %{position: true}, at) when since != nil,
    do: {%{detector | position_lost: nil}, [{"position.restored", %{"duration" => lasted(since, at)}, []}]}

  defp position(detector, _last, _now, _at), do: {detector, []}

  defp receiver(detector, %{rc_receiver: true}, %{rc_receiver: false}, at), do: rc(detector, :lost, nil, at)
  defp receiver(detector, %{rc_receiver: false}, %{rc_receiver: true}, at), do: rc(detector, :back, nil, at)
  defp receiver(detector, _last, _now, _at), do: {detector, []}

  defp fence_end(%{fence_open: {_since, _breach}} = detector, last, now, at) do
    if now[:fence_breach] == false or (last[:fence_check] not in [nil, false] and now[:fence_check] == false),
      do: fence_over(detector, at),
      else: {detector, []}
  end

  defp fence_end(detector, _last, _now, _at), do: {detector, []}

  defp fence_over(%{fence_open: {since, breach}} = detector, at) do
    {%{detector | fence_open: nil},
     [{"geofence.cleared", %{"breach" => breach, "duration" => lasted(since, at)}, []}]}
  end

  @doc "Parameters that have new values: ArduPilot says nothing of a fence any more that is switched off."
  @spec params(Detector.t(), %{String.t() => term()}, integer()) :: {Detector.t(), [Detector.step()]}
  def params(%{fence_open: {_since, _breach}} = detector, %{"FENCE_ENABLE" => 0}, at),
    do: fence_over(detector, at)

  def params(detector, _values, _at), do: {detector, []}

  @doc "The remote control is lost, or there again, as a text, a report or the receiver's state says."
  @spec rc(Detector.t(), :lost | :back | nil, String.t() | nil, integer()) ::
          {Detector.t(), [Detector.step()]}
  def rc(%{rc_lost: nil} = detector, :lost, text, at),
    do: {%{detector | rc_lost: at}, [{"rc.lost", %{"text" => text}, []}]}

  def rc(%{rc_lost: since} = detector, :back, text, at) when since != nil do
    data = %{"text" => text, "duration" => lasted(since, at)}
    {%{detector | rc_lost: nil}, [{"rc.restored", data, []}]}
  end

  def rc(detector, _known, _text, _at), do: {detector, []}

  @doc "The kill switch is engaged, or not any more."
  @spec kill(Detector.t(), boolean() | nil, String.t() | nil) :: {Detector.t(), [Detector.step()]}
  def kill(%{killed: known} = detector, on?, _text) when on? in [known, nil], do: {detector, []}

  def kill(detector, on?, text) do
    type = if on?, do: "kill_switch.engaged", else: "kill_switch.released"
    {%{detector | killed: on?}, [{type, %{"text" => text}, []}]}
  end

  @doc "What is wrong with the vehicle just now that a failsafe may come of, the likeliest first."
  @spec troubles(Detector.t()) :: [String.t()]
  def troubles(detector) do
    for {type, true} <- [
          {"fence", detector.fence_open != nil},
          {"gps", detector.gps_lost != nil},
          {"position", detector.position_lost != nil},
          {"rc", detector.rc_lost != nil},
          {"gcs", detector.gcs},
          {"battery", :critical in Map.values(detector.battery)}
        ],
        do: type
  end

  @doc "After a reboot nothing of this is known."
  @spec forgotten(Detector.t()) :: Detector.t()
  def forgotten(detector),
    do: %{detector | gps_lost: nil, position_lost: nil, rc_lost: nil, fence_open: nil, killed: false}

  defp said(detector, at, type),
    do: %{detector | failsafe: Failsafe.said(detector.failsafe, at, type, type)}

  defp lasted(since, at), do: Float.round(max(at - since, 0) / 1_000_000, 1)
end
