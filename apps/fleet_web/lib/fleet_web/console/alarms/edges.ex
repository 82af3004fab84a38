defmodule FleetWeb.Console.Alarms.Edges do
  @moduledoc "Turns events of vehicles into alarms: which condition begins, which is over. Pure."

  alias Aerie.Vehicle.Event
  alias FleetWeb.Console.Alarms

  # Event that begins a condition => kind, severity, text.
  @begins %{
    "geofence" => {:fence, :critical, "fence breached"},
    "battery.low" => {:battery, :warning, "battery low"},
    "battery.critical" => {:battery, :critical, "battery nearly empty"},
    "rc.lost" => {:rc, :warning, "remote control lost"},
    "gps.lost" => {:gps, :critical, "GNSS position lost"},
    "position.lost" => {:position, :critical, "the estimator has no position"},
    "kill_switch.engaged" => {:kill_switch, :critical, "kill switch engaged"},
    "gcs.lost" => {:gcs, :warning, "its ground station fell silent"}
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
    action = if data["action"] in [nil, "none"], do: "", else: ": #{data["action"]}"
    reason = data["reason"] || kind
    text = "#{vehicle}: failsafe #{reason}#{action}"
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
    text = "#{vehicle}: #{words}#{detail(kind, data)}"
    condition = %{key: {kind, vehicle}, severity: severity, text: text, vehicle: vehicle}
    Alarms.raise_alarm(alarms, :events, condition, at)
  end

  def apply(alarms, %Event{type: type, vehicle: vehicle, time: at}) when is_map_key(@ends, type),
    do: Alarms.clear(alarms, {Map.fetch!(@ends, type), vehicle}, at)

  def apply(alarms, _other), do: alarms

  defp detail(:battery, %{"remaining" => remaining}) when is_number(remaining),
    do: ", #{round(remaining * 100)} % left"

  defp detail(:battery, %{"voltage" => voltage}) when is_number(voltage),
    do: ", #{Float.round(voltage / 1, 1)} V"

  defp detail(:fence, %{"breach" => breach}) when is_binary(breach), do: " (#{breach})"
  defp detail(_kind, _data), do: ""

  defp by_event?({:failsafe, {vehicle, _type}}, vehicle), do: true
  defp by_event?({kind, vehicle}, vehicle), do: kind in [:battery | Map.values(@ends)]
  defp by_event?(_other, _vehicle), do: false
end
