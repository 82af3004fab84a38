defmodule Aerie.Console.Pages.Operations.Words do
  @moduledoc "What becomes of each vehicle of an operation, and of all of them, in words. Pure."

  @under_way %{
    "set_mode" => "Setting the mode",
    "wait_alone" => "Waiting for its turn",
    "arm" => "Arming",
    "disarm" => "Disarming",
    "takeoff" => "Climbing",
    "wait_above" => "Climbing",
    "set_altitude" => "Changing height",
    "wait_apart" => "Changing height",
    "rtl" => "Returning",
    "land" => "Landing",
    "wait_landed" => "Landing",
    "hold" => "Stopping",
    "mission_start" => "Starting the mission",
    "shadow" => "Sending"
  }
  @reached %{
    "takeoff" => "Up",
    "rtl" => "Returning",
    "land" => "Landing",
    "hold" => "Holding",
    "mission_start" => "Flying the mission",
    "shadow" => "Sent"
  }
  @refused ~w(rejected denied)
  @named 3

  @typedoc "`:kind` of a badge; `:group` is the word without what is different for each vehicle."
  @type word :: %{vehicle: String.t(), kind: String.t(), group: String.t(), text: String.t()}

  @doc "What an operation is called."
  @spec name(map()) :: String.t()
  def name(%{"name" => name}) when is_binary(name), do: name

  def name(%{"what" => %{"command" => %{"type" => type}}}),
    do: type |> String.replace("_", " ") |> String.capitalize()

  def name(%{"what" => %{"shadow" => _change}}), do: "Desired state"
  def name(_sequence), do: "Operation"

  @doc "A word for each vehicle, in their order. `height` gives the metres of one that climbs; nil: not known."
  @spec vehicles(map(), (String.t() -> number() | nil)) :: [word()]
  def vehicles(%{"order" => order, "vehicles" => vehicles} = operation, height) do
    for id <- order, do: Map.put(word(vehicles[id], operation, fn -> height.(id) end), :vehicle, id)
  end

  defp word(%{"state" => "waiting"}, %{"state" => state}, _height) when state in ~w(running paused),
    do: say("plain", "Waiting")

  defp word(%{"state" => "waiting"}, %{"state" => "stopped"}, _height), do: say("plain", "Stopped")
  defp word(%{"state" => "waiting"}, _halted, _height), do: say("plain", "Not begun")

  defp word(%{"state" => "under_way"} = vehicle, operation, height) do
    group = Map.get(@under_way, vehicle["step"] || List.last(steps(operation)), "Under way")
    metres = if group == "Climbing", do: height.()
    say("info", group, if(metres, do: "#{group} #{round(metres)} m", else: group))
  end

  defp word(%{"state" => "ok"}, operation, _height),
    do: say("ok", operation |> steps() |> Enum.reverse() |> Enum.find_value("Done", &@reached[&1]))

  defp word(%{"result" => "unknown", "reason" => reason}, _operation, _height),
    do: failed("warn", "Not known", reason)

  defp word(%{"result" => result, "reason" => reason}, _operation, _height) when result in @refused,
    do: failed("bad", "Refused", reason)

  defp word(%{"result" => "timeout", "reason" => reason}, _operation, _height),
    do: failed("bad", "No answer", reason)

  defp word(%{"reason" => reason}, _operation, _height), do: failed("bad", "Failed", reason)

  defp failed(kind, group, reason), do: say(kind, group, if(reason, do: "#{group}: #{reason}", else: group))
  defp say(kind, group, text \\ nil), do: %{kind: kind, group: group, text: text || group}

  defp steps(%{"what" => %{"sequence" => steps}}), do: steps
  defp steps(%{"what" => %{"command" => %{"type" => type}}}), do: [type]
  defp steps(%{"what" => %{"shadow" => _change}}), do: ["shadow"]

  @doc "How many are how: `3 up, 1 climbing, 1 refused: sim-004`; those that went wrong with their names."
  @spec counts([word()]) :: String.t()
  def counts(words) do
    for group <- words |> Enum.map(& &1.group) |> Enum.uniq() do
      of_group = Enum.filter(words, &(&1.group == group))

      "#{length(of_group)} #{String.downcase(group)}#{names(hd(of_group).kind, Enum.map(of_group, & &1.vehicle))}"
    end
    |> Enum.join(", ")
  end

  defp names(kind, vehicles) when kind in ~w(bad warn) do
    {named, more} = Enum.split(vehicles, @named)
    ": " <> Enum.join(named, ", ") <> if(more == [], do: "", else: " and #{length(more)} more")
  end

  defp names(_kind, _vehicles), do: ""

  @doc "The line of an operation: `Take off 5: 3 up, 1 climbing, 1 waiting`."
  @spec line(map(), [word()]) :: String.t()
  def line(operation, words) do
    waiting = operation["counts"]["waiting"]
    all = length(words)
    name = name(operation)

    case operation["state"] do
      "interrupted" -> "#{name}: interrupted at #{all - waiting} of #{all}; #{waiting} not begun"
      "halted" -> "#{name}: halted at #{all - waiting} of #{all}; #{counts(words)}"
      "paused" -> "#{name} #{all}, paused: #{counts(words)}"
      _state -> "#{name} #{all}: #{counts(words)}"
    end
  end
end
