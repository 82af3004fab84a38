defmodule Aerie.Console.Pages.Vehicle.Events.Timeline do
  @moduledoc "A vehicle's events and texts as lines that can be filtered by severity. Pure."

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Event

  @max 200
  @levels [all: 7, notice: 5, warning: 4, error: 3]
  @names ~w(emergency alert critical error warning notice info debug)

  @typedoc "`:tone` of `severity` (0 emergency to 7 debug): `:bad` to 3, `:warn` for 4, `:plain` for the rest."
  @type line :: %{
          id: String.t(),
          time: integer(),
          type: String.t(),
          severity: 0..7,
          name: String.t(),
          tone: :bad | :warn | :plain,
          text: String.t()
        }

  @doc "The levels to choose from, by name."
  @spec levels() :: [String.t()]
  def levels, do: for({name, _least} <- @levels, do: Atom.to_string(name))

  @doc "The lines of events, newest first, at most #{@max}. `level`: one of `levels/0`; `search`: a part of the type or text."
  @spec lines([Event.t()], level :: String.t(), search :: String.t()) :: [line()]
  def lines(events, level \\ "all", search \\ "") do
    least = for({name, least} <- @levels, Atom.to_string(name) == level, do: least) |> List.first(7)
    search = String.downcase(search)

    events
    |> Enum.reverse()
    |> Stream.map(&line/1)
    |> Stream.filter(
      &(&1.severity <= least and String.contains?(String.downcase("#{&1.type} #{&1.text}"), search))
    )
    |> Enum.take(@max)
  end

  @doc "The line of an event."
  @spec line(Event.t()) :: line()
  def line(%{type: type, data: data} = event) do
    row = Event.declared(type)
    severity = severity(row, data)

    %{
      id: event.id,
      time: event.time,
      type: type,
      severity: severity,
      name: Enum.at(@names, severity),
      tone: tone(severity),
      text: text(type, row[:text], data)
    }
  end

  defp severity(row, data) do
    case {row, data} do
      {%{severity: :data}, %{"severity" => severity}} when severity in 0..7 -> severity
      {%{severity: severity}, _data} when is_integer(severity) -> severity
      _unknown -> 6
    end
  end

  defp tone(severity) when severity <= 3, do: :bad
  defp tone(4), do: :warn
  defp tone(_severity), do: :plain

  defp text("statustext", _row, %{"component" => part} = data), do: "component #{part}: #{data["text"]}"
  defp text("statustext", _row, data), do: data["text"] || ""

  defp text("report", _row, data),
    do: join(label(data["name"] || "report #{data["id"]}"), [values(data["values"])])

  defp text("failsafe", _row, data) do
    join("failsafe: #{label(data["reason"] || data["type"])}", [
      action(data["action"]),
      brackets(data["text"])
    ])
  end

  defp text("failsafe.cleared", _row, data), do: "failsafe over: #{label(data["reason"] || data["type"])}"

  defp text("operator.changed", _row, data),
    do: charge_of(data["operator"], data["before"], data["reason"])

  defp text(type, template, data) when template != nil, do: render(template, data) <> amount(type, data)

  defp text(type, _row, %{"text" => text}) when is_binary(text) and text != "", do: "#{label(type)}: #{text}"
  defp text(type, _row, data), do: join(label(type), [plain(data)])

  # As `t:Aerie.Vehicle.Event.Types.t/0` describes it. In one pass: a value may have braces.
  defp render(template, data) do
    Regex.replace(~r/\[(.+?)\]|[^\[]+/, template, fn
      part, "" -> insert(part, data)
      _all, part -> if known?(part, data), do: insert(part, data), else: ""
    end)
  end

  defp known?(part, data),
    do: Enum.all?(Regex.scan(~r/{(\w+)}/, part), fn [_all, name] -> data[name] not in [nil, ""] end)

  defp insert(part, data) do
    Regex.replace(~r/(\(?){(\w+)}/, part, fn
      _all, "(", name -> "(" <> label(format(data[name]))
      _all, "", name -> format(data[name])
    end)
  end

  defp amount("battery." <> _level, %{"remaining" => share}) when is_number(share),
    do: ": #{round(share * 100)} %"

  defp amount("battery." <> _level, %{"voltage" => volts}) when is_number(volts),
    do: ": #{format(volts * 1.0)} V"

  defp amount("link.lost", %{"silent_s" => seconds}) when is_number(seconds), do: " for #{round(seconds)} s"
  defp amount(_type, _data), do: ""

  defp charge_of(nil, before, _reason), do: "#{before || "the operator"} is no longer in charge"
  defp charge_of(operator, nil, _reason), do: "#{operator} took charge"

  defp charge_of(operator, before, reason),
    do: join("#{operator} took over from #{before}", [brackets(reason)])

  defp brackets(text) when is_binary(text) and text != "", do: "(#{label(text)})"
  defp brackets(_none), do: nil

  defp action(action) when action in [nil, "none"], do: nil
  defp action(action), do: "→ #{label(action)}"

  defp values(list) when is_list(list) and list != [],
    do: list |> Enum.take(6) |> Enum.map_join(" ", &format/1)

  defp values(_none), do: nil

  # The short fields, sorted by name.
  defp plain(data) do
    case for {name, value} <- Enum.sort(data),
             is_binary(value) or is_number(value) or is_boolean(value),
             do: "#{name} #{format(value)}" do
      [] -> nil
      fields -> fields |> Enum.take(4) |> Enum.join(", ")
    end
  end

  defp join(text, more), do: Enum.join([text | Enum.reject(more, &(&1 in [nil, ""]))], " ")
  defp label(nil), do: "unknown"
  defp label(name), do: name |> to_string() |> String.replace(["_", "."], " ")

  defp format(number) when is_float(number),
    do: number |> Float.round(3) |> Json.number()

  defp format(list) when is_list(list), do: Enum.map_join(list, " ", &format/1)
  defp format(nil), do: "unknown"
  defp format(other) when is_binary(other) or is_number(other) or is_boolean(other), do: to_string(other)
  defp format(other), do: inspect(other, limit: 5)
end
