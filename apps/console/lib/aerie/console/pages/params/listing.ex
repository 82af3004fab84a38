defmodule Aerie.Console.Pages.Params.Listing do
  @moduledoc "The rows of a vehicle's parameters that a page shows. Pure."

  alias Aerie.Control.{Params, Policy}
  alias Aerie.Vehicle.Snapshot
  alias MavCodec.Enums.MavParamType

  @max 200
  # MAV_PARAM_EXT_TYPE_CUSTOM.
  @text 11

  @typedoc """
    * `:value`, `:default` - as text; the default is nil if the vehicle does not tell it
    * `:changed` - it differs from the default; nil if that is not known
    * `:type` - `int32`, `real32` …
    * `:exact` - false for an integer that the vehicle's float cannot carry in full
    * `:file` - what the opened file says, if it says something else
    * `:about` - what the vehicle says about it, if that was read
  """
  @type row :: %{
          name: String.t(),
          value: String.t(),
          default: String.t() | nil,
          changed: boolean() | nil,
          type: String.t(),
          exact: boolean(),
          file: String.t() | nil,
          about: map() | nil
        }

  @typedoc "`:search`: words that all have to occur in the name or the short description; `:only`: `\"all\"`, `\"changed\"`, or `\"differs\"` from the file."
  @type filter :: %{search: String.t(), only: String.t()}

  @doc "The choices of what is shown."
  @spec choices() :: [String.t()]
  def choices, do: ~w(all changed differs)

  @doc "The largest number of rows that are shown."
  @spec max() :: pos_integer()
  def max, do: @max

  @doc """
  At most #{@max} rows in the order of their names, and the total number. `entries` are those of an opened file, `about` what the vehicle says about
  its parameters, by name.
  """
  @spec rows(map(), [map()], %{String.t() => map()}, filter()) ::
          {[row()], count :: non_neg_integer()}
  def rows(table, entries, about, filter) do
    file = Map.new(entries, &{&1.name, &1})
    words = filter.search |> String.upcase() |> String.split()

    found =
      for {_name, param} <- Enum.sort(table.params),
          text = String.upcase("#{param.name} #{about[param.name][:short]}"),
          Enum.all?(words, &String.contains?(text, &1)),
          row = row(param, file[param.name], about[param.name]),
          shown?(filter.only, row),
          do: row

    {Enum.take(found, @max), length(found)}
  end

  defp shown?("changed", row), do: row.changed == true
  defp shown?("differs", row), do: row.file != nil
  defp shown?(_all, _row), do: true

  @doc "The row of a parameter, with its value in a file and what the vehicle says about it; nil for none."
  @spec row(map(), map() | nil, map() | nil) :: row()
  def row(param, entry, about) do
    %{
      name: param.name,
      value: text(param.value),
      default: param.default && text(param.default),
      changed: Params.changed?(param),
      type: type(param.type),
      exact: param.exact,
      file: if(entry != nil and not Params.says?(entry, param), do: text(entry.value)),
      about: about
    }
  end

  @doc """
  What a button that sets parameters applies to: the vehicle, its component (nil: the autopilot), and what the operator sees there: the value
  that a parameter has, or the entries of a file that would be set.
  """
  @spec target(vehicle :: String.t(), 1..255 | nil, String.t() | [map()]) :: String.t()
  def target(vehicle, component, seen),
    do: Enum.join([vehicle, component || "autopilot", :erlang.phash2(seen)], " ")

  @doc "What to think of before parameters of a vehicle (its snapshot) are set."
  @spec cautions([String.t()], map() | nil) :: [String.t()]
  def cautions(names, vehicle) do
    mode = Snapshot.data(vehicle || %{groups: %{}}, :mode)
    protecting = Enum.filter(names, &Policy.protects?/1)

    [
      protecting != [] && "What protects the vehicle changes: #{listed(protecting)}.",
      mode[:armed] != false && "The vehicle is armed, or may be.",
      mode[:in_air] != false && "The vehicle is in the air, or may be."
    ]
    |> Enum.filter(& &1)
  end

  @doc "Names of parameters in a few words."
  @spec listed([String.t()]) :: String.t()
  def listed(names) when length(names) <= 5, do: Enum.join(names, ", ")
  def listed(names), do: "#{length(names)} of them (#{names |> Enum.take(3) |> Enum.join(", ")} …)"

  @doc "The value of such a type in the text of a field: of a component's text (MAV_PARAM_EXT_TYPE_CUSTOM) the text, else a number."
  @spec value(String.t(), type :: 1..11) :: {:ok, number() | String.t()} | :error
  def value(text, @text), do: {:ok, text}
  def value(text, _number), do: number(text)

  @doc "The number in the text of a field."
  @spec number(String.t()) :: {:ok, number()} | :error
  def number(text) do
    text = String.trim(text)

    case {Integer.parse(text), Float.parse(text)} do
      {{number, ""}, _float} -> {:ok, number}
      {_integer, {number, ""}} -> {:ok, number}
      _neither -> :error
    end
  end

  @doc "A value as text, with only the digits that its 32-bit float has."
  @spec text(number() | String.t() | nil) :: String.t()
  def text(nil), do: "not a number"
  def text(text) when is_binary(text), do: text
  def text(number) when is_integer(number), do: Integer.to_string(number)

  def text(number) when trunc(number) == number and abs(number) < 1.0e15,
    do: number |> trunc() |> Integer.to_string()

  def text(number), do: :erlang.float_to_binary(short(number, 6), [:short])

  # The shortest decimal that gives this float.
  defp short(number, digits) when digits <= 9 do
    rounded = "~.#{digits}e" |> :io_lib.format([number]) |> IO.iodata_to_binary() |> String.to_float()
    if Params.same?(rounded, number), do: rounded, else: short(number, digits + 1)
  end

  defp short(number, _digits), do: number

  defp type(@text), do: "text"
  defp type(type), do: String.downcase(MavParamType.label(type) || "type #{type}")
end
