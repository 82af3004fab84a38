defmodule Aerie.Params.File do
  @moduledoc """
  Parameter files as ground stations write them.

    * `.param` - Mission Planner writes `NAME,VALUE`, MAVProxy `NAME VALUE`; `#` begins a comment
    * `.params` - QGroundControl: system, component, name, value and MAV_PARAM_TYPE, separated by tabs

  The format is recognised from the lines. A file has at most 1 MiB and as many parameters as a vehicle
  (`Aerie.Params.Table.max/0`); errors are reported with their line numbers, at most twenty.
  """

  alias Aerie.Params.Table
  alias Aerie.Protocol.ParamValue

  @max_bytes 1_048_576
  @max_errors 20
  # MAVProxy always writes six decimals.
  @rounded 6

  @typedoc "`type` is nil in a `.param` file; `decimals`: how many the value is written with, 0 for an integer."
  @type entry :: %{
          name: String.t(),
          value: number(),
          type: 1..10 | nil,
          decimals: non_neg_integer(),
          line: pos_integer()
        }
  @type error :: {line :: pos_integer() | nil, String.t()}

  @doc "The parameters of a file, in its order."
  @spec parse(binary()) :: {:ok, [entry()]} | {:error, [error(), ...]}
  def parse(text) when byte_size(text) > @max_bytes,
    do: {:error, [{nil, "the file has #{byte_size(text)} bytes, more than #{@max_bytes}"}]}

  def parse(text) do
    if String.valid?(text), do: lines(text), else: {:error, [{nil, "the file is not text in UTF-8"}]}
  end

  defp lines(text) do
    {entries, errors} =
      text
      |> String.trim_leading("\uFEFF")
      |> String.split(["\r\n", "\n", "\r"])
      |> Enum.with_index(1)
      |> Enum.reduce({[], []}, fn {line, number}, {entries, errors} ->
        case line(String.trim(line), number) do
          nil -> {entries, errors}
          {:ok, entry} -> {[entry | entries], errors}
          {:error, reason} -> {entries, [{number, reason} | errors]}
        end
      end)

    entries = Enum.reverse(entries)

    case Enum.reverse(errors) ++ twice(entries) ++ too_many(entries) do
      [] when entries == [] -> {:error, [{nil, "the file has no parameters"}]}
      [] -> {:ok, entries}
      errors -> {:error, Enum.take(errors, @max_errors)}
    end
  end

  defp line("", _number), do: nil
  defp line("#" <> _comment, _number), do: nil

  defp line(line, number) do
    case line |> uncommented() |> String.split(~r/[\s,]+/, trim: true) do
      [name, value] -> entry(name, value, nil, number)
      [_system, _component, name, value, type] -> typed(name, value, type, number)
      _other -> {:error, "expected a name and a value, or system, component, name, value and type"}
    end
  end

  defp uncommented(line), do: line |> String.split("#", parts: 2) |> hd()

  defp typed(name, value, type, number) do
    case Integer.parse(type) do
      {type, ""} when type in 1..10 -> entry(name, value, type, number)
      _other -> {:error, "expected a MAV_PARAM_TYPE of 1 to 10, got #{inspect(type)}"}
    end
  end

  defp entry(name, text, type, number) do
    with {:name, true} <- {:name, ParamValue.name?(name)},
         {:ok, value} <- number(text),
         :ok <- fits(value, type) do
      {:ok, %{name: name, value: value, type: type, decimals: decimals(text), line: number}}
    else
      {:name, false} ->
        {:error, "expected a name of 1 to 16 characters, got #{inspect(String.slice(name, 0, 40))}"}

      {:error, reason} ->
        {:error, "#{name}: #{reason}"}
    end
  end

  # The type decides whether `5.000000` is an integer.
  defp number(text) do
    case {Integer.parse(text), Float.parse(text)} do
      {{value, ""}, _float} -> {:ok, value}
      {_part, {value, ""}} -> {:ok, value}
      _neither -> {:error, "expected a number, got #{inspect(String.slice(text, 0, 40))}"}
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

  defp twice(entries) do
    entries
    |> Enum.group_by(& &1.name, & &1.line)
    |> Enum.flat_map(fn
      {_name, [_once]} -> []
      {name, [first | rest]} -> Enum.map(rest, &{&1, "#{name} is already in line #{first}"})
    end)
    |> Enum.sort()
  end

  defp too_many(entries) do
    if length(entries) > Table.max(),
      do: [{nil, "#{length(entries)} parameters, more than #{Table.max()}"}],
      else: []
  end

  @doc "Whether an entry of a file matches a vehicle's value: the same 32-bit float, or the same digits if the file has it rounded."
  @spec says?(entry(), number() | nil) :: boolean()
  def says?(%{value: value, decimals: decimals}, actual) do
    ParamValue.same?(value, actual) or
      (decimals >= @rounded and is_float(actual) and
         abs(value - actual) <= 0.500001 * :math.pow(10, -decimals))
  end

  @doc """
  A file of a list: `:param` for Mission Planner and MAVProxy, `:params` for QGroundControl. Ordered by name. A value that is not a
  number is a comment.
  """
  @spec format(Table.t(), :param | :params, {system :: non_neg_integer(), component :: 0..255}) :: String.t()
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

  # The fewest digits that give the same 32-bit float; without an exponent if possible, because some readers do not know exponents.
  defp text(value) when is_integer(value), do: Integer.to_string(value)

  defp text(value) do
    1..20
    |> Enum.map(&:erlang.float_to_binary(value, decimals: &1))
    |> Enum.find(Float.to_string(value), &ParamValue.same?(String.to_float(&1), value))
  end
end
