defmodule Protocols.Mission.File.Waypoints do
  @moduledoc """
  Waypoint files, `QGC WPL 110`: a line per item with twelve numbers; the first line is home. Mission Planner,
  QGroundControl and MAVProxy read and write them. They hold the mission only. In the older `QGC WPL 120` the first line is the
  first item: no home is given.

  Numbers may have gaps, where somebody deleted a line. Items count by their order, as MAVProxy and ArduPilot's tests
  read such files, and so do the targets of jumps.
  """

  alias Protocols.Mission.File.Value
  alias Protocols.Mission.{Item, Plan, Transfer}
  alias Aerie.Base.Files.Text
  alias MavCodec.Enums.MavCmd

  @header "QGC WPL 110"
  @without_home "QGC WPL 120"
  @max_bytes 4 * 1024 * 1024
  @waypoint MavCmd.value(:MAV_CMD_NAV_WAYPOINT)
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)

  @doc "The plan of a text, or an error with the line."
  @spec read(binary()) :: {:ok, Plan.t()} | {:error, String.t()}
  def read(text) when byte_size(text) > @max_bytes, do: {:error, "the file is larger than 4 MiB"}

  def read(text) do
    with {:ok, lines} <- Text.lines(text),
         {:ok, header, lines} <- header(lines),
         :ok <- few(lines),
         {:ok, numbered} <- Value.all(lines, fn {line, at}, _n -> item(line, "line #{at}") end),
         :ok <- rising(numbered) do
      {:ok, plan(header, for({_index, item, _at} <- numbered, do: item))}
    end
  end

  defp rising([{0, _home, _at} | numbered]) do
    Enum.reduce_while(numbered, 0, fn {index, _item, at}, before ->
      if is_integer(index) and index > before,
        do: {:cont, index},
        else: {:halt, {:error, "#{at}: expected an item after #{before}, got #{inspect(index)}"}}
    end)
    |> then(&if is_integer(&1), do: :ok, else: &1)
  end

  defp rising([{index, _item, at} | _]), do: {:error, "#{at}: expected item 0, got #{inspect(index)}"}

  @doc "The mission of a plan as text. An unset value is `nan`."
  @spec write(Plan.t()) :: binary()
  def write(plan) do
    {{x, y}, z} = plan.home || {{0, 0}, 0.0}
    home = %Item{command: @waypoint, frame: 0, x: x, y: y, z: z}

    lines =
      for {item, seq} <- Enum.with_index([home | plan.items]) do
        numbers = Enum.map(Value.numbers(item), &number/1)

        Enum.join(
          [seq, if(seq == 0, do: 1, else: 0), item.frame, item.command | numbers] ++ [item.autocontinue],
          "\t"
        )
      end

    Enum.join([@header | lines], "\n") <> "\n"
  end

  defp header([{header, _at}]) when header in [@header, @without_home],
    do: {:error, "the file has no items after its first line"}

  defp header([{header, _at} | lines]) when header in [@header, @without_home], do: {:ok, header, lines}

  defp header([{line, at} | _]), do: Value.error("line #{at}", expected(), line)
  defp header([]), do: {:error, "the file is empty; it must begin with #{expected()}"}

  defp expected, do: "#{inspect(@header)} or #{inspect(@without_home)}"

  defp few(lines) do
    limit = Transfer.limit()

    if length(lines) <= limit,
      do: :ok,
      else: {:error, "the file has #{length(lines)} items; at most #{limit} are read"}
  end

  # With its number, and where it stands.
  defp item(line, at) do
    with [_, _, _, _, _, _, _, _, _, _, _, _] = texts <- String.split(line),
         {:ok, [index, _current, frame, command | rest]} <-
           Value.all(texts, &parsed(&1, "#{at} column #{&2}")),
         {params, [autocontinue]} = Enum.split(rest, 7),
         {:ok, item} <-
           Value.item(whole(frame), whole(command), params, autocontinue not in [0, 0.0, nil], at) do
      {:ok, {whole(index), item, at}}
    else
      texts when is_list(texts) -> {:error, "#{at}: expected 12 columns, got #{length(texts)}"}
      error -> error
    end
  end

  # Some programs write all numbers with a decimal point.
  defp whole(value) when is_float(value) and trunc(value) == value, do: trunc(value)
  defp whole(value), do: value

  defp parsed(text, at) do
    case {Text.number(text), String.downcase(text)} do
      {{:ok, value}, _text} -> {:ok, value}
      {:error, text} when text in ["nan", "-nan"] -> {:ok, nil}
      {:error, text} -> Value.error(at, "a number", text)
    end
  end

  defp plan(@header, [home | items]) do
    known? = home.x not in [nil, 0] or home.y not in [nil, 0]
    %Plan{home: if(known?, do: {{home.x || 0, home.y || 0}, home.z || 0.0}), items: items}
  end

  # A plan counts its items from 1, this file from 0.
  defp plan(@without_home, items), do: %Plan{items: Enum.map(items, &jump/1)}

  defp jump(%{command: @jump, params: {target, repeat, p3, p4}} = item) when is_number(target),
    do: %{item | params: {target + 1, repeat, p3, p4}}

  defp jump(item), do: item

  defp number(nil), do: "nan"
  defp number(value), do: "#{value}"
end
