defmodule Aerie.Control.Params.File do
  @moduledoc """
  Parameter files as ground stations write them.

    * `.param` - Mission Planner writes `NAME,VALUE`, MAVProxy `NAME VALUE`, others `NAME=VALUE`; `#` begins a comment
    * `.params` - QGroundControl: system, component, name, value and MAV_PARAM_TYPE, separated by tabs
    * `.txt` - Betaflight and iNav: what their command lines print (`Aerie.Control.Params.File.CommandLine`)

  The format is recognised from the lines. Values are decimal or, as `0xFF`, hexadecimal. The last value of a repeated
  name counts. Rows of another component than the autopilot are left out, and rows of another vehicle are an error. A
  file has at most 1 MiB and as many parameters as a vehicle (`Aerie.Control.Params.Table.max/0`); errors are reported
  with their line numbers, at most twenty.
  """

  alias Aerie.Control.Params.File.CommandLine
  alias Aerie.Control.Params.{LongNames, Table}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Message.ParamValue
  alias Aerie.Base.Files.Text
  alias MavCodec.Enums.MavComponent
  alias MavCodec.Msp.Message

  @max_bytes 1_048_576
  @max_errors 20
  # MAVProxy always writes six decimals.
  @rounded 6
  @autopilot MavComponent.value(:MAV_COMP_ID_AUTOPILOT1)
  @hex ~r/\A([+-]?)0[xX]([0-9a-fA-F]{1,16})\z/

  @typedoc "`type` is nil in a `.param` file; `decimals`: how many the value is written with, 0 for an integer."
  @type entry :: %{
          name: String.t(),
          value: number(),
          type: 1..10 | nil,
          decimals: non_neg_integer(),
          line: pos_integer()
        }
  @type error :: {line :: pos_integer() | nil, String.t()}
  @typedoc "Whose rows are read: system and component of an autopilot; nil for any one system."
  @type owner :: {system :: non_neg_integer() | nil, component :: 0..255}

  @doc "Whether a vehicle's command line prints parameters, in the format `:txt`."
  @spec prints?(CommandLine.release() | nil) :: boolean()
  defdelegate prints?(release), to: CommandLine

  @doc "The parameters of a file, in its order, for the autopilot of any one vehicle."
  @spec parse(binary()) :: {:ok, [entry()]} | {:error, [error(), ...]}
  def parse(text), do: with({:ok, entries, _remarks} <- read(text, {nil, @autopilot}), do: {:ok, entries})

  @doc """
  The parameters of a file for a vehicle's autopilot, and sentences about what was left out. What words mean depends on
  the firmware and its version: the vehicle's, or the one that the file names.
  """
  @spec read(binary(), owner(), {firmware :: atom(), Message.version() | nil} | nil) ::
          {:ok, [entry()], remarks :: [String.t()]} | {:error, [error(), ...]}
  def read(text, owner, release \\ nil)

  def read(text, _owner, _release) when byte_size(text) > @max_bytes,
    do: {:error, [{nil, "the file has #{byte_size(text)} bytes, more than #{@max_bytes}"}]}

  def read(text, owner, release) do
    case Text.lines(text) do
      {:ok, lines} ->
        if CommandLine.lines?(lines),
          do: settings(lines, owner, release, CommandLine.release(text)),
          else: lines |> Enum.map(&line/1) |> rows(owner)

      {:error, reason} ->
        {:error, [{nil, reason}]}
    end
  end

  defp settings(_lines, _owner, {firmware, _version}, {named, _of_file}) when firmware != named,
    do: {:error, [{nil, "the file is of #{Firmware.title(named)}, and the vehicle has another firmware"}]}

  defp settings(lines, owner, release, named) do
    release = if prints?(release), do: release, else: named
    {settings, remarks} = CommandLine.settings(lines, release)
    entries = for {name, value, line} <- settings, do: entry(name, value, nil, line)
    with {:ok, entries, more} <- rows(entries, owner), do: {:ok, entries, remarks ++ more}
  end

  defp rows(lines, {system, component}) do
    rows = for {:ok, entry, whose} <- lines, do: {entry, whose}

    {own, others} =
      Enum.split_with(rows, fn {_entry, whose} -> whose == nil or elem(whose, 1) == component end)

    {entries, twice} = own |> Enum.map(&elem(&1, 0)) |> last()

    case for({:error, error} <- lines, do: error) ++ strangers(rows, system) ++ too_many(entries) do
      [] when rows == [] ->
        {:error, [{nil, "the file has no parameters"}]}

      [] when entries == [] ->
        {:error, [{nil, "the file has no parameters of component #{component}, the autopilot"}]}

      [] ->
        {:ok, entries, left_out(others) ++ twice}

      errors ->
        {:error, errors |> Enum.sort() |> Enum.take(@max_errors)}
    end
  end

  # The first row's system, if the vehicle's is not known.
  defp strangers(rows, system) do
    named = for {entry, {system, _component}} <- rows, do: {entry.line, system}
    system = system || with([{_line, first} | _] <- named, do: first)

    for {line, other} <- named, other != system do
      {line,
       "the row is of the vehicle with system id #{other}, not of #{system}: a file without the first two columns is for any vehicle"}
    end
  end

  defp left_out(others) do
    for {component, rows} <- Enum.group_by(others, fn {_entry, {_system, component}} -> component end) do
      names = rows |> Enum.take(5) |> Enum.map_join(", ", fn {entry, _whose} -> entry.name end)
      more = if length(rows) > 5, do: " …", else: ""
      "left out, because they are of component #{component} and not of the autopilot: #{names}#{more}"
    end
  end

  # If a name comes twice, the last value counts.
  defp last(entries) do
    lines = Enum.group_by(entries, & &1.name, & &1.line)
    entries = Enum.filter(entries, &(&1.line == List.last(lines[&1.name])))

    remarks =
      for entry <- entries, [_, _ | _] = lines <- [lines[entry.name]] do
        "#{entry.name} is in the lines #{Enum.join(Enum.take(lines, -5), ", ")}: the last one counts"
      end

    {entries, Enum.take(remarks, @max_errors)}
  end

  defp line({line, number}) do
    case String.split(line, ~r/[\s,=]+/, trim: true) do
      [name, value] ->
        entry(name, value, nil, number)

      [system, component, name, value, type] ->
        row(system, component, typed(name, value, type, number), number)

      _other ->
        error(number, "expected a name and a value, or system, component, name, value and type")
    end
  end

  defp row(system, component, {:ok, entry, nil}, number) do
    case {Integer.parse(system), Integer.parse(component)} do
      {{system, ""}, {component, ""}} when system in 0..0xFFFF_FFFF and component in 0..255 ->
        {:ok, entry, {system, component}}

      _other ->
        error(number, "expected the ids of a system and a component")
    end
  end

  defp row(_system, _component, error, _number), do: error

  defp error(number, reason), do: {:error, {number, reason}}

  defp typed(name, value, type, number) do
    case Integer.parse(type) do
      {type, ""} when type in 1..10 ->
        entry(name, value, type, number)

      _other ->
        error(number, "expected a MAV_PARAM_TYPE of 1 to 10, got #{inspect(String.slice(type, 0, 40))}")
    end
  end

  defp entry(name, text, type, number) do
    with {:name, true} <- {:name, LongNames.name?(name)},
         {:ok, value} <- number(text),
         :ok <- fits(value, type) do
      {:ok, %{name: name, value: value, type: type, decimals: decimals(text), line: number}, nil}
    else
      {:name, false} ->
        error(number, "expected a name of 1 to 16 characters, got #{inspect(String.slice(name, 0, 40))}")

      {:error, reason} ->
        error(number, "#{name}: #{reason}")
    end
  end

  # The type decides whether `5.000000` is an integer.
  defp number(text) do
    with :error <- Text.number(text), :error <- hexadecimal(text) do
      {:error, "expected a number, got #{inspect(String.slice(text, 0, 40))}"}
    end
  end

  defp hexadecimal(text) do
    case Regex.run(@hex, text) do
      [_all, sign, digits] -> {:ok, String.to_integer(sign <> digits, 16)}
      nil -> :error
    end
  end

  defp fits(value, type) do
    case ParamValue.range(type) do
      nil -> if(abs(value) <= 3.5e38, do: :ok, else: {:error, "#{value} is too large"})
      {low, high} when value >= low and value <= high and value == trunc(value) -> :ok
      {low, high} -> {:error, "expected an integer of #{low} to #{high}, got #{value}"}
    end
  end

  defp decimals(text) do
    case String.split(text, ".") do
      [_whole, decimals] -> byte_size(decimals)
      _integer -> 0
    end
  end

  defp too_many(entries) do
    if length(entries) > Table.max(),
      do: [{nil, "#{length(entries)} parameters, more than #{Table.max()}"}],
      else: []
  end

  @doc """
  Whether an entry of a file matches a vehicle's value: the same 32-bit float, or the same digits if the file has it
  rounded.
  """
  @spec says?(entry(), number() | nil) :: boolean()
  def says?(%{value: value, decimals: decimals}, actual) do
    ParamValue.same?(value, actual) or
      (decimals >= @rounded and is_float(actual) and
         abs(value - actual) <= 0.500001 * :math.pow(10, -decimals))
  end

  @doc """
  A file of a list: `:param` for Mission Planner and MAVProxy, `:params` for QGroundControl, `{:txt, release}` for the
  command line of Betaflight or iNav. Ordered by name. A value that is not a number is a comment.
  """
  @spec format(
          Table.t(),
          :param | :params | {:txt, CommandLine.release()},
          {system :: non_neg_integer(), component :: 0..255}
        ) :: String.t()
  def format(table, {:txt, release}, _source) do
    words = CommandLine.words(release)

    lines =
      Enum.map_join(Table.sorted(table), fn param ->
        unless_unusable(param, &CommandLine.text(words, &1.name, text(&1.value)))
      end)

    "#{CommandLine.head(release)}#{lines}save\n"
  end

  def format(table, :param, _source),
    do:
      Enum.map_join(
        Table.sorted(table),
        &unless_unusable(&1, fn param -> "#{param.name},#{text(param.value)}\n" end)
      )

  def format(table, :params, {system, component}) do
    header = "# Onboard parameters for Vehicle #{system}\n#\n# Vehicle-Id Component-Id Name Value Type\n"

    header <>
      Enum.map_join(Table.sorted(table), fn param ->
        unless_unusable(param, &"#{system}\t#{component}\t#{&1.name}\t#{text(&1.value)}\t#{&1.type}\n")
      end)
  end

  defp unless_unusable(%{value: nil} = param, _line), do: "# #{param.name} is not a number on board\n"
  defp unless_unusable(param, line), do: line.(param)

  # The fewest digits that give the same 32-bit float; without an exponent if possible, because some readers do not know
  # exponents.
  defp text(value) when is_integer(value), do: Integer.to_string(value)

  defp text(value) do
    1..20
    |> Enum.map(&:erlang.float_to_binary(value, decimals: &1))
    |> Enum.find(Float.to_string(value), &ParamValue.same?(String.to_float(&1), value))
  end
end
