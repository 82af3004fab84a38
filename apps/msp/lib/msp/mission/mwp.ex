defmodule Msp.Mission.Mwp do
  @moduledoc """
  Mission files of mwp and of iNav's configurator: XML with a `missionitem` for each waypoint of iNav, with 1e-7 degrees as decimals, heights in
  metres, and the waypoint's own parameters. They hold a mission only, and no home.

  What a waypoint is as an item of a plan is in `Msp.Mission`. A file with several missions, or with what iNav would not fly, is an
  error that names the item.
  """

  alias Protocols.Mission.{Item, Plan}
  alias MavCodec.Enums.MavCmd

  @max_bytes 1024 * 1024
  @names Map.merge(Map.new(Msp.Mission.actions(), fn {number, name} -> {name, number} end), %{
           "POSHOLD_TIME" => 3
         })
  # The hold's name in these files.
  @written Map.put(Msp.Mission.actions(), 3, "POSHOLD_TIME")
  @jump MavCmd.value(:MAV_CMD_DO_JUMP)
  @last 165
  # RTH, JUMP, SET_HEAD
  @nowhere [4, 6, 7]

  @doc "The plan of a text, or an error."
  @spec read(binary()) :: {:ok, Plan.t()} | {:error, String.t()}
  def read(text) when byte_size(text) > @max_bytes, do: {:error, "the file is larger than 1 MiB"}

  def read(text) do
    with {:ok, elements} <- elements(text),
         {:ok, waypoints} <- waypoints(elements),
         {:ok, messages} <- Msp.Mission.items(waypoints),
         # What another program wrote may be what iNav does not arm with.
         {:ok, _flown} <- checked(messages) do
      {:ok, %Plan{items: Enum.map(messages, &(&1 |> Item.read() |> jump(1)))}}
    end
  end

  @doc "The mission of a plan as text. iNav must have all of it."
  @spec write(Plan.t()) :: {:ok, binary()} | {:error, String.t()}
  def write(%Plan{items: items}) do
    messages =
      for {item, seq} <- Enum.with_index(items), do: item |> jump(-1) |> Item.message(seq, 0, {0, 0})

    with {:ok, waypoints} <- checked(messages) do
      lines = for waypoint <- waypoints, do: ["  <missionitem", attributes(waypoint), "></missionitem>\n"]

      {:ok,
       IO.iodata_to_binary([
         ~s(<?xml version="1.0" encoding="utf-8"?>\n<mission>\n  <version value="2.3-pre8"></version>\n),
         lines,
         "</mission>\n"
       ])}
    end
  end

  # A plan counts its items from 1.
  defp jump(%{command: @jump, params: {target, repeat, p3, p4}} = item, by) when is_number(target),
    do: %{item | params: {target + by, repeat, p3, p4}}

  defp jump(item, _by), do: item

  defp checked(messages) do
    with {:error, {_kind, why}} <- Msp.Mission.waypoints(messages), do: {:error, why}
  end

  defp attributes(w) do
    for {name, value} <- [
          no: w.number,
          action: @written[w.action],
          lat: decimal(w.lat, 10_000_000),
          lon: decimal(w.lon, 10_000_000),
          alt: decimal(w.altitude, 100),
          parameter1: w.p1,
          parameter2: w.p2,
          parameter3: w.p3,
          flag: w.flag
        ],
        do: ~s( #{name}="#{value}")
  end

  defp decimal(number, parts) when rem(number, parts) == 0, do: div(number, parts)
  defp decimal(number, parts), do: :erlang.float_to_binary(number / parts, [:compact, decimals: 7])

  # --- XML

  # Names and values stay text: nothing from a file becomes an atom. Entities could make a small file a large one.
  defp elements(text) do
    options = [:disallow_entities, external_entities: :none, event_fun: &event/3, event_state: []]

    case :xmerl_sax_parser.stream(text, options) do
      {:ok, found, _rest} ->
        {:ok, Enum.reverse(found)}

      {:fatal_error, {_path, _name, line}, why, _tags, _state} ->
        {:error, "line #{line}: the file is not XML: #{why}"}

      {_other, {_path, _name, line}, _why, _tags, _state} ->
        {:error, "line #{line}: the file is not XML"}
    end
  rescue
    # The parser's own, on bytes that are not text.
    _any -> {:error, "the file is not XML"}
  end

  defp event({:startElement, _uri, name, _qualified, attributes}, {_path, _file, line}, found) do
    if name |> to_string() |> String.downcase() == "missionitem",
      do: [
        {line, Map.new(attributes, fn {_, _, key, value} -> {String.downcase("#{key}"), "#{value}"} end)}
        | found
      ],
      else: found
  end

  defp event(_other, _at, found), do: found

  defp waypoints([]), do: {:error, "the file has no missionitem"}

  defp waypoints(elements) do
    limit = Msp.Mission.most()

    if length(elements) > limit,
      do: {:error, "the file has #{length(elements)} items; iNav has room for #{limit}"},
      else: numbered(elements)
  end

  defp numbered(elements) do
    count = length(elements)

    elements
    |> Enum.with_index(1)
    |> Enum.reduce_while({:ok, []}, fn {{line, fields}, number}, {:ok, done} ->
      case waypoint(fields, number, count) do
        {:ok, waypoint} -> {:cont, {:ok, [waypoint | done]}}
        {:error, why} -> {:halt, {:error, "line #{line}, item #{number}: #{why}"}}
      end
    end)
    |> then(&with {:ok, done} <- &1, do: {:ok, Enum.reverse(done)})
  end

  defp waypoint(fields, number, count) do
    with {:ok, action} <- action(fields["action"]),
         :ok <- whole(fields, placed(action, fields["flag"])),
         {:ok, [lat, lon]} <- numbers(fields, ["lat", "lon"], 10_000_000),
         {:ok, [altitude]} <- numbers(fields, ["alt"], 100),
         {:ok, [p1, p2, p3, flag]} <- numbers(fields, ["parameter1", "parameter2", "parameter3", "flag"], 1) do
      cond do
        flag == @last and number < count ->
          {:error, "a mission ends here, and another one follows: one is read"}

        flag not in 0..255 ->
          {:error, "flag goes from 0 to 255"}

        true ->
          {:ok, place(action, number, {lat, lon, altitude}, {p1, p2, p3, flag(flag, number, count)})}
      end
    end
  end

  # What a waypoint may not lack: 0 would be a place, and a height.
  defp placed(action, _flag) when action in @nowhere, do: []
  defp placed(_action, "72"), do: ["alt"]
  defp placed(_action, _flag), do: ["lat", "lon", "alt"]

  defp whole(fields, names) do
    case Enum.find(names, &(not is_map_key(fields, &1))) do
      nil -> :ok
      name -> {:error, "#{name} is missing"}
    end
  end

  # Files have coordinates where iNav has none.
  defp place(action, number, {lat, lon, altitude}, {p1, p2, p3, flag}) do
    {lat, lon, altitude} =
      if action in @nowhere or flag == 72,
        do: {0, 0, if(flag == 72, do: altitude, else: 0)},
        else: {lat, lon, altitude}

    %{
      number: number,
      action: action,
      lat: lat,
      lon: lon,
      altitude: altitude,
      p1: p1,
      p2: p2,
      p3: p3,
      flag: flag
    }
  end

  defp flag(_any, count, count), do: @last
  defp flag(flag, _number, _count), do: flag

  defp action(nil), do: {:error, "action is missing"}

  defp action(name) do
    case Map.fetch(@names, String.upcase(name)) do
      {:ok, number} ->
        {:ok, number}

      :error ->
        {:error,
         "expected an action (#{@names |> Map.keys() |> Enum.sort() |> Enum.join(", ")}), got #{inspect(String.slice(name, 0, 40))}"}
    end
  end

  defp numbers(fields, names, parts) do
    Enum.reduce_while(names, {:ok, []}, fn name, {:ok, done} ->
      case Float.parse(Map.get(fields, name, "0")) do
        {number, ""} when abs(number) < 1.0e9 ->
          {:cont, {:ok, done ++ [round(number * parts)]}}

        _other ->
          {:halt,
           {:error, "expected a number for #{name}, got #{inspect(String.slice(fields[name], 0, 40))}"}}
      end
    end)
  end
end
