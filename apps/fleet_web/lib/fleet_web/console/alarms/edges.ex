defmodule FleetWeb.Console.Alarms.Edges do
  @moduledoc "Turns events of vehicles into alarms: which condition begins, which is over. Pure."

  alias Aerie.Vehicle.Event
  alias FleetWeb.Console.Alarms
  alias Aerie.Vehicle.Snapshot

  # Event that begins a condition => kind, severity, text.
  @begins %{
    "geofence" => {:fence, :critical, "Fence breached"},
    "battery.low" => {:battery, :warning, "Battery low"},
    "battery.critical" => {:battery, :critical, "Battery nearly empty"},
    "rc.lost" => {:rc, :warning, "Remote control lost"},
    "gps.lost" => {:gps, :critical, "GNSS position lost"},
    "position.lost" => {:position, :critical, "Position estimate lost"},
    "kill_switch.engaged" => {:kill_switch, :critical, "Kill switch engaged"},
    "gcs.lost" => {:gcs, :warning, "Ground station lost"}
  }
  @ends %{
    "geofence.cleared" => :fence,
    "rc.restored" => :rc,
    "gps.restored" => :gps,
    "position.restored" => :position,
    "kill_switch.released" => :kill_switch,
    "gcs.restored" => :gcs
  }

  @doc "The alarms after an event. Events of other types change nothing."
  @spec apply(Alarms.t(), Event.t()) :: Alarms.t()
  def apply(alarms, %Event{type: "failsafe", vehicle: vehicle, data: data, time: at}) do
    kind = data["type"] || "unknown"
    action = if data["action"] in [nil, "none"], do: "", else: " → #{words(data["action"])}"
    reason = data["reason"] || kind
    text = "Failsafe: #{words(reason)}#{action}"
    condition = %{key: {:failsafe, {vehicle, kind}}, severity: :critical, text: text, vehicle: vehicle}
    Alarms.raise_alarm(alarms, :events, condition, at)
  end

  def apply(alarms, %Event{type: "failsafe.cleared", vehicle: vehicle, data: data, time: at}),
    do: Alarms.clear(alarms, {:failsafe, {vehicle, data["type"] || "unknown"}}, at)

  # A restarted vehicle reports no end of earlier conditions, and its battery has probably been changed.
  def apply(alarms, %Event{type: "reboot", vehicle: vehicle, time: at}),
    do: Alarms.clear_all(alarms, &by_event?(&1, vehicle), at)

  def apply(alarms, %Event{type: type, vehicle: vehicle, data: data, time: at})
      when is_map_key(@begins, type) do
    {kind, severity, words} = Map.fetch!(@begins, type)
    text = words <> detail(kind, data)
    condition = %{key: {kind, vehicle}, severity: severity, text: text, vehicle: vehicle}
    Alarms.raise_alarm(alarms, :events, condition, at)
  end

  def apply(alarms, %Event{type: type, vehicle: vehicle, time: at}) when is_map_key(@ends, type),
    do: Alarms.clear(alarms, {Map.fetch!(@ends, type), vehicle}, at)

  def apply(alarms, _other), do: alarms

  @doc """
  The alarms with their texts as the vehicles' snapshots have the values now: an event tells only what a value was when it began.
  A lost vehicle's alarms keep what was known last.
  """
  @spec follow(Alarms.t(), [map()]) :: Alarms.t()
  def follow(alarms, vehicles) do
    for %{id: id, status: :online} = vehicle <- vehicles,
        charge = charge(Snapshot.data(vehicle, :battery)),
        reduce: alarms,
        do: (alarms -> Alarms.reword(alarms, {:battery, id}, &(words_of_battery(&1.severity) <> charge)))
  end

  # Of several batteries the emptiest.
  defp charge(battery) do
    shares = for %{remaining: share} when is_number(share) <- [battery | battery[:batteries] || []], do: share

    case {shares, battery[:voltage]} do
      {[_ | _], _voltage} -> detail(:battery, %{"remaining" => Enum.min(shares)})
      {[], voltage} when is_number(voltage) -> detail(:battery, %{"voltage" => voltage})
      _unknown -> nil
    end
  end

  defp words_of_battery(:critical), do: @begins |> Map.fetch!("battery.critical") |> elem(2)
  defp words_of_battery(_low), do: @begins |> Map.fetch!("battery.low") |> elem(2)

  defp detail(:battery, %{"remaining" => remaining}) when is_number(remaining),
    do: ", #{round(remaining * 100)} % left"

  defp detail(:battery, %{"voltage" => voltage}) when is_number(voltage),
    do: ", #{Float.round(voltage / 1, 1)} V"

  defp detail(:fence, %{"breach" => breach}) when is_binary(breach), do: " (#{words(breach)})"
  defp detail(_kind, _data), do: ""

  defp words(name), do: name |> to_string() |> String.replace("_", " ")

  defp by_event?({:failsafe, {vehicle, _type}}, vehicle), do: true
  defp by_event?({kind, vehicle}, vehicle), do: kind in [:battery | Map.values(@ends)]
  defp by_event?(_other, _vehicle), do: false
end
