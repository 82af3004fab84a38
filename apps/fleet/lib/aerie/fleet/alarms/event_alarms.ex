defmodule Aerie.Fleet.Alarms.EventAlarms do
  @moduledoc "Turns events of vehicles into alarms: which condition begins, which is over. Pure."

  alias Aerie.Vehicle.Event
  alias Aerie.Fleet.Alarms
  alias Aerie.Vehicle.Snapshot

  @doc "The alarms after an event. Events that neither begin nor end one (`Aerie.Vehicle.Event.Types`) change nothing."
  @spec apply(Alarms.t(), Event.t()) :: Alarms.t()
  def apply(alarms, %Event{type: type, vehicle: vehicle, data: data, time: at}) do
    case Event.Types.get(type) do
      %{begins: {kind, severity, text}} ->
        key = key(kind, vehicle, data)
        condition = %{key: key, severity: severity, text: text <> detail(kind, data), vehicle: vehicle}
        Alarms.raise_alarm(alarms, :events, condition, at)

      # A restarted vehicle reports no end of earlier conditions, and its battery has probably been changed.
      %{ends: :all} ->
        Alarms.clear_all(alarms, &by_event?(&1, vehicle), at)

      %{ends: kind} when kind != nil ->
        Alarms.clear(alarms, key(kind, vehicle, data), at)

      _other ->
        alarms
    end
  end

  # A vehicle may have several failsafes at once.
  defp key(:failsafe, vehicle, data), do: {:failsafe, {vehicle, data["type"] || "unknown"}}
  defp key(kind, vehicle, _data), do: {kind, vehicle}

  @doc """
  The alarms with their texts as the vehicles' snapshots have the values now: an event tells only what a value was when it began.
  A lost vehicle's alarms keep what was known last.
  """
  @spec follow(Alarms.t(), [map()]) :: Alarms.t()
  def follow(alarms, vehicles) do
    for %{id: id, status: :online} = vehicle <- vehicles,
        charge = charge(Snapshot.data(vehicle, :battery)),
        reduce: alarms,
        do: (alarms -> Alarms.reword(alarms, {:battery, id}, &(battery_text(&1.severity) <> charge)))
  end

  # The emptiest of several batteries.
  defp charge(battery) do
    shares = for %{remaining: share} when is_number(share) <- [battery | battery[:batteries] || []], do: share

    case {shares, battery[:voltage]} do
      {[_ | _], _voltage} -> detail(:battery, %{"remaining" => Enum.min(shares)})
      {[], voltage} when is_number(voltage) -> detail(:battery, %{"voltage" => voltage})
      _unknown -> nil
    end
  end

  defp battery_text(:critical), do: elem(Event.Types.get("battery.critical").begins, 2)
  defp battery_text(_low), do: elem(Event.Types.get("battery.low").begins, 2)

  defp detail(:battery, %{"remaining" => remaining}) when is_number(remaining),
    do: ", #{round(remaining * 100)} % left"

  defp detail(:battery, %{"voltage" => voltage}) when is_number(voltage),
    do: ", #{Float.round(voltage / 1, 1)} V"

  defp detail(:failsafe, data) do
    action = if data["action"] in [nil, "none"], do: "", else: " → #{spaced(data["action"])}"
    ": #{spaced(data["reason"] || data["type"] || "unknown")}#{action}"
  end

  defp detail(:fence, %{"breach" => breach}) when is_binary(breach), do: " (#{spaced(breach)})"
  defp detail(_kind, _data), do: ""

  defp spaced(name), do: name |> to_string() |> String.replace("_", " ")

  defp by_event?({:failsafe, {vehicle, _type}}, vehicle), do: true

  defp by_event?({kind, vehicle}, vehicle),
    do: Enum.any?(Event.Types.all(), &match?(%{begins: {^kind, _severity, _text}}, &1))

  defp by_event?(_other, _vehicle), do: false
end
