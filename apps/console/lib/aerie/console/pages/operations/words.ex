defmodule Aerie.Console.Pages.Operations.Words do
  @moduledoc """
  What becomes of each vehicle of an operation, and of all of them, in words of what was reached: a landing is *Landing*
  until the vehicle has landed, whatever it does later. Pure: all of it comes from the operation, the vehicles and their
  events, so each page says the same, however late it is opened.
  """

  alias Aerie.Console.Commands.Entry
  alias Aerie.Vehicle.{Firmware, Snapshot}

  @under_way %{
    "set_mode" => "Setting the mode",
    "wait_alone" => "Waiting for its turn",
    "arm" => "Arming",
    "disarm" => "Disarming",
    "takeoff" => "Climbing",
    "wait_above" => "Climbing",
    "set_altitude" => "Changing height",
    "wait_at" => "Changing height",
    "wait_turn" => "Waiting for its turn",
    "wait_time" => "Waiting for its turn",
    "goto" => "Flying there",
    "wait_near" => "Flying there",
    "rtl" => "Returning",
    "land" => "Landing",
    "wait_landed" => "Landing",
    "hold" => "Stopping",
    "mission_start" => "Starting the mission",
    "shadow" => "Sending",
    # Somebody commanded it lately, or is in charge of it.
    "shadow_held" => "Held off"
  }
  @reached %{
    "takeoff" => "Up",
    "rtl" => "Returning",
    "land" => "Landing",
    "hold" => "Holding",
    "set_mode" => "In the mode",
    "set_altitude" => "Height set",
    "mission_start" => "Flying the mission",
    "take_control" => "In charge",
    "release_control" => "Released",
    "shadow" => "Sent"
  }
  # Actions of a mode in which a command is still carried out.
  @same %{"Landing" => [:land, :return], "Returning" => [:land, :return], "Holding" => [:hold, :hold_height]}
  @landed ~w(landed disarmed)
  @named 3
  @listed 12
  # Sequences that give each vehicle a height of its own before it returns.
  @stacked ["Return", "Return all"]
  @shown_us 60_000_000
  # A landing that nobody has seen end.
  @flight_us 900_000_000

  @typedoc """
    * `:kind` - of a badge; `:group` - the word without what is different for each vehicle; `:reason` - of a failure
    * `:going?` - the vehicle is still at what it was told; `:at` - when that ended, where it is known
    * `:outside?` - it returns outside of the stack of the others, because its firmware takes no height
  """
  @type word :: %{
          vehicle: String.t(),
          kind: String.t(),
          group: String.t(),
          text: String.t(),
          reason: String.t() | nil,
          going?: boolean(),
          outside?: boolean(),
          at: integer() | nil
        }

  @typedoc "Reads a vehicle, and its events since a time."
  @type look :: {(String.t() -> Snapshot.t() | nil), (String.t(), since :: integer() | nil -> [map()])}

  @doc "What an operation is called."
  @spec name(map()) :: String.t()
  def name(%{"name" => name}) when is_binary(name), do: name

  def name(%{"what" => %{"command" => %{"type" => type}}}),
    do: type |> String.replace("_", " ") |> String.capitalize()

  def name(%{"what" => %{"shadow" => _change}}), do: "Desired state"
  def name(_sequence), do: "Operation"

  @doc "A word for each vehicle: first those that need somebody, the others in their order."
  @spec vehicles(map(), look()) :: [word()]
  def vehicles(%{"order" => order, "vehicles" => vehicles} = operation, {vehicle, events}) do
    words =
      for id <- order do
        look = {fn -> vehicle.(id) end, fn -> events.(id, unix(operation["begun_at"])) end}
        outside? = stacked?(operation) and outside?(vehicle.(id))
        vehicles[id] |> word(operation, look) |> Map.merge(%{vehicle: id, outside?: outside?})
      end

    Enum.sort_by(words, &need(&1.kind))
  end

  defp need("bad"), do: 0
  defp need("warn"), do: 1
  defp need(_other), do: 2

  defp stacked?(%{"name" => name, "what" => %{"sequence" => _steps}, "order" => [_one, _two | _more]}),
    do: name in @stacked

  defp stacked?(_other), do: false

  defp outside?(nil), do: false

  defp outside?(%{autopilot: autopilot, vehicle_type: kind}),
    do: Firmware.of(autopilot).gap("set_altitude", kind) != nil

  defp word(%{"state" => "waiting"}, %{"state" => state}, _look) when state in ~w(running paused),
    do: say("plain", "Waiting")

  defp word(%{"state" => "waiting"}, %{"state" => "stopped"}, _look), do: say("plain", "Stopped")
  defp word(%{"state" => "waiting"}, _halted, _look), do: say("plain", "Not begun")

  defp word(%{"state" => "under_way"} = vehicle, operation, {snapshot, _events}) do
    group = Map.get(@under_way, vehicle["step"] || List.last(steps(operation)), "Under way")
    metres = if group == "Climbing", do: height(snapshot.())
    %{say("info", group) | text: if(metres, do: "#{group} #{round(metres)} m", else: group), going?: true}
  end

  # Seen aboard, and not only wanted.
  defp word(%{"state" => "ok", "result" => "converged"}, _operation, _look), do: say("ok", "Aboard")

  defp word(%{"state" => "ok"}, operation, look) do
    word = operation |> steps() |> Enum.reverse() |> Enum.find_value("Done", &@reached[&1])
    if is_map_key(@same, word), do: later(word, look), else: say("ok", word)
  end

  defp word(%{"result" => result, "reason" => reason}, _operation, _look) do
    {tone, group} = Entry.result(result)
    word = say(Entry.badge(tone), group)
    if reason, do: %{word | reason: reason, text: "#{group}: #{reason}"}, else: word
  end

  # What the vehicle makes of it afterwards.
  defp later(word, {snapshot, events}) do
    data = with(%{} = seen <- snapshot.(), do: Snapshot.data(seen, :mode), else: (nil -> %{}))
    same? = Firmware.action(data[:mode]) in [nil | @same[word]]

    cond do
      same? and data[:in_air] != false -> %{say("ok", word) | going?: word != "Holding"}
      word == "Holding" and (same? or data[:in_air] == false) -> say("ok", word)
      landed = word != "Holding" && Enum.find(events.(), &(&1.type in @landed)) -> landed(landed.time)
      data[:in_air] == false -> landed(nil)
      true -> say("plain", "No longer #{String.downcase(word)}")
    end
  end

  defp landed(at), do: %{say("ok", "Landed") | at: at}

  defp height(nil), do: nil
  defp height(snapshot), do: Snapshot.data(snapshot, :position)[:alt_rel]

  defp say(kind, group),
    do: %{kind: kind, group: group, text: group, reason: nil, going?: false, at: nil}

  @doc "Whether it is shown at `now` (unix microseconds): until a minute after its end, and that of its landings."
  @spec shown?(map(), [word()], now :: integer()) :: boolean()
  def shown?(%{"done_at" => done_at, "state" => state}, words, now) do
    ends = for %{at: at} when at != nil <- words, do: at
    latest = Enum.max([unix(done_at) || now | ends])
    going? = Enum.any?(words, & &1.going?)
    state in ~w(halted interrupted) or now - latest < if(going?, do: @flight_us, else: @shown_us)
  end

  defp unix(nil), do: nil

  defp unix(text) do
    {:ok, at, _offset} = DateTime.from_iso8601(text)
    DateTime.to_unix(at, :microsecond)
  end

  defp steps(%{"what" => %{"sequence" => steps}}), do: steps
  defp steps(%{"what" => %{"command" => %{"type" => type}}}), do: [type]
  defp steps(%{"what" => %{"shadow" => _change}}), do: ["shadow"]

  @doc """
  How many are how: `3 up, 1 climbing, 1 not allowed: sim-004 (arm: no)`; those that went wrong with their names, and
  the reason if it is the same for all of them.
  """
  @spec counts([word()]) :: String.t()
  def counts(words) do
    groups = words |> Enum.map(& &1.group) |> Enum.uniq()

    for group <- groups, of_group = Enum.filter(words, &(&1.group == group)) do
      many = if tl(groups) == [] and tl(words) != [], do: "all", else: length(of_group)
      "#{many} #{String.downcase(group)}#{names(of_group)}"
    end
    |> Enum.join(", ")
  end

  defp names([%{kind: kind, reason: reason} | _] = words) when kind in ~w(bad warn) do
    why = if reason && Enum.all?(words, &(&1.reason == reason)), do: " (#{reason})"
    ": #{named(words)}#{why}"
  end

  defp names(_words), do: ""

  defp named(words) do
    {named, more} = words |> Enum.map(& &1.vehicle) |> Enum.split(@named)
    "#{Enum.join(named, ", ")}#{if more != [], do: " and #{length(more)} more"}"
  end

  @doc "Which vehicles are on their way home outside of the others' stack; nil for none."
  @spec outside([word()]) :: String.t() | nil
  def outside(words) do
    case Enum.filter(words, &(&1.outside? and &1.going?)) do
      [] -> nil
      some -> "Outside the stack, at the firmware's own height: #{named(some)}"
    end
  end

  @doc "Those that are listed, and how many more there are: of many, those still at it before those that are over."
  @spec listed([word()]) :: {[word()], non_neg_integer()}
  def listed(words) when length(words) <= @listed, do: {words, 0}

  def listed(words) do
    {listed, more} = words |> Enum.sort_by(&{need(&1.kind), not &1.going?}) |> Enum.split(@listed)
    {listed, length(more)}
  end

  @doc "The line of an operation: `Take off 5: 3 up, 1 climbing, 1 waiting`, `Land: sim-002 landed`."
  @spec line(map(), [word()]) :: String.t()
  def line(operation, words) do
    waiting = operation["counts"]["waiting"]
    all = length(words)
    name = name(operation)

    case {operation["state"], words} do
      {"interrupted", _words} -> "#{name}: interrupted at #{all - waiting} of #{all}; #{waiting} not begun"
      {"halted", _words} -> "#{name}: halted at #{all - waiting} of #{all}; #{counts(words)}"
      {"paused", _words} -> "#{name} #{all}, paused: #{counts(words)}"
      {_state, [word]} -> "#{name}: #{word.vehicle} #{lower(word.text)}"
      _several -> "#{name} #{all}: #{counts(words)}"
    end
  end

  defp lower(<<first::utf8, rest::binary>>), do: String.downcase(<<first::utf8>>) <> rest
end
