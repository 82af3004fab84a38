defmodule Aerie.Vehicle.Event.Text do
  @moduledoc """
  An event as people read it: how severe it is, and its text, by what its type declares
  (`Aerie.Vehicle.Event.Types`).
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Event

  @doc "The severity (MAV_SEVERITY: 0 emergency to 7 debug) and the text of an event."
  @spec of(Event.t()) :: %{severity: 0..7, text: String.t()}
  def of(%{type: type, data: data}) do
    row = Event.Types.get(type)
    %{severity: severity(row, data), text: text(type, row[:text], data)}
  end

  defp severity(row, data) do
    case {row, data} do
      {%{severity: :data}, %{"severity" => severity}} when severity in 0..7 -> severity
      {%{severity: severity}, _data} when is_integer(severity) -> severity
      _unknown -> 6
    end
  end

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
