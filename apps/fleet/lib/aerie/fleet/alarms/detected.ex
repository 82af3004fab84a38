defmodule Aerie.Fleet.Alarms.Detected do
  @moduledoc """
  The alarms that events of vehicles begin. They hold as long as the vehicle's detector has their condition
  (`t:Aerie.Vehicle.Events.Detector.condition/0`), so none outlives its cause, whatever event was lost. Pure.
  """

  alias Aerie.Fleet.Alarms.Core
  alias Aerie.Vehicle.{Event, Snapshot}
  alias Aerie.Vehicle.Events.Detector

  @source :detected

  @doc """
  The alarms as the detectors of the vehicles have them at `now`; `detected` are their conditions by vehicle. A vehicle
  that is lost keeps its own. One that only another gateway hears, or that was removed, has none: nothing would end it.
  """
  @spec put(Core.t(), %{String.t() => [Detector.condition()]}, [vehicle :: map()], integer()) :: Core.t()
  def put(alarms, detected, vehicles, now) do
    conditions =
      for %{id: id} = vehicle <- vehicles,
          vehicle.via == nil,
          one <- Map.get(detected, id, []),
          do: id |> condition(one) |> Map.put(:text, text(one, vehicle))

    Core.put(alarms, @source, conditions, now)
  end

  @doc "Whether an event begins or ends an alarm."
  @spec about?(Event.t()) :: boolean()
  def about?(%{type: type}) do
    case Event.Types.get(type) do
      %{begins: nil, ends: nil} -> false
      row -> row != nil
    end
  end

  @doc "After an event: an alarm that began and is over already stays until somebody has seen it."
  @spec told(Core.t(), Event.t(), [Detector.condition()]) :: Core.t()
  def told(alarms, %Event{vehicle: vehicle, time: at} = event, detected) do
    subject = if event.type == "failsafe", do: {event.data["type"], event.data["reason"]}
    told = %{type: event.type, subject: subject, since: at, data: event.data}

    if begins(event.type) == nil or Enum.any?(detected, &same?(&1, told)) do
      alarms
    else
      condition = condition(vehicle, told)
      alarms |> Core.raise_alarm(@source, condition, at) |> Core.clear(condition.key, at)
    end
  end

  # A battery that has become critical was low before.
  defp same?(one, other),
    do: kind(one.type) == kind(other.type) and (one.subject == other.subject or other.subject == nil)

  defp kind(type), do: with({kind, _severity, _text} <- begins(type), do: kind)
  defp begins(type), do: with(%{begins: begins} <- Event.Types.get(type), do: begins)

  defp condition(vehicle, %{type: type, subject: subject} = one) do
    {kind, severity, _text} = begins(type)
    key = {kind, if(subject == nil, do: vehicle, else: {vehicle, subject})}
    row = Event.Types.get(type)
    why = one.data["text"] || row.when <> if(row.over, do: "; over with #{row.over}", else: "")

    %{
      key: key,
      severity: severity,
      text: text(one, %{}),
      vehicle: vehicle,
      since: one.since,
      why: why,
      mend: row.mend
    }
  end

  # An event says only what a value was when it began; the snapshot has what it is.
  defp text(%{type: type, data: data}, vehicle) do
    {kind, _severity, text} = begins(type)
    text <> detail(kind, data, vehicle)
  end

  defp detail(:battery, data, vehicle) do
    battery = if data["several"], do: " (battery #{data["battery"] || "without an id"})", else: ""
    said = if data["said"], do: ", the vehicle says #{data["said"]}", else: ""
    battery <> left(data, vehicle) <> said
  end

  defp detail(:failsafe, data, _vehicle) do
    action = if data["action"] in [nil, "none"], do: "", else: " → #{spaced(data["action"])}"
    reason = data["reason"] || data["type"]
    if(reason in [nil, "unknown"], do: " (no reason given)", else: ": #{spaced(reason)}") <> action
  end

  defp detail(:fence, %{"breach" => breach}, _vehicle) when is_binary(breach), do: " (#{spaced(breach)})"
  defp detail(_kind, _data, _vehicle), do: ""

  defp left(%{"remaining" => remaining}, _vehicle) when is_number(remaining),
    do: ", #{round(remaining * 100)} % left"

  defp left(data, vehicle) do
    own = Snapshot.data(Map.put_new(vehicle, :groups, %{}), :battery)

    if is_number(own[:voltage]) and data["battery"] in [nil, own[:id]],
      do: ", #{Float.round(own.voltage / 1, 1)} V",
      else: ", charge unknown"
  end

  defp spaced(name), do: name |> to_string() |> String.replace("_", " ")
end
