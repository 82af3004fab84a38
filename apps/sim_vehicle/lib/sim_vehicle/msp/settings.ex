defmodule SimVehicle.Msp.Settings do
  @moduledoc """
  The settings of iNav by name or number, with the firmware's checks: a value shorter than its type is refused, a longer one is cut, and of
  unsigned ones only the upper limit counts.
  """

  alias MavCodec.Msp.Params

  @types %{
    "u8" => {0, 8},
    "i8" => {1, 8},
    "u16" => {2, 16},
    "i16" => {3, 16},
    "u32" => {4, 32},
    "f32" => {5, 32},
    "str" => {6, 128}
  }
  @sections %{"master" => 0, "profile" => 8, "control" => 16, "battery" => 24, "mixer" => 32, "ez" => 40}
  @lookup 0x40
  @table Params.all(:inav, {9, 0}) |> Enum.with_index()

  @type t :: %{String.t() => binary}

  @doc "All at the least value that they may have, or 0."
  @spec new() :: t
  def new, do: Map.new(@table, fn {row, _index} -> {row.name, encode(row, max(row.low, 0))} end)

  defp encode(%{type: "str"}, _value), do: :binary.copy(<<0>>, 16)
  defp encode(%{type: "f32"}, value), do: <<value * 1.0::32-little-float>>
  defp encode(row, value), do: <<round(value)::size(bits(row))-little>>

  defp bits(row), do: elem(@types[row.type], 1)

  @doc "The reply to COMMON_SETTING_INFO."
  @spec info(t, binary) :: {:ok, binary} | :error
  def info(settings, request) do
    with {row, index, _rest} <- find(request) do
      {type, _bits} = @types[row.type]
      words = for word <- row.values, into: <<>>, do: word <> <<0>>
      mode = if row.values == [], do: 0, else: @lookup
      {low, high} = if row.type == "f32", do: {trunc(row.low), trunc(row.high)}, else: {row.low, row.high}

      {:ok,
       <<row.name::binary, 0, 0::16, type, Map.get(@sections, row.section, 0), mode, low::32-little,
         high::32-little, index::16-little, 0, 1>> <>
         words <> settings[row.name]}
    end
  end

  @doc "The reply to COMMON_SETTING."
  @spec get(t, binary) :: {:ok, binary} | :error
  def get(settings, request), do: with({row, _index, _rest} <- find(request), do: {:ok, settings[row.name]})

  @doc "COMMON_SET_SETTING."
  @spec set(t, binary) :: {:ok, t} | :error
  def set(settings, request) do
    with {row, _index, value} <- find(request),
         size = div(bits(row), 8),
         true <- byte_size(value) >= size,
         value = binary_part(value, 0, size),
         true <-
           row.type in ["f32", "str", "i8", "i16"] or :binary.decode_unsigned(value, :little) <= row.high do
      {:ok, Map.put(settings, row.name, value)}
    else
      _wrong -> :error
    end
  end

  # By its number behind a NUL, or by its name with a NUL behind.
  defp find(<<0, index::16-little, rest::binary>>) do
    with {row, index} <- Enum.at(@table, index, :error), do: {row, index, rest}
  end

  defp find(request) do
    with [name, rest] <- :binary.split(request, <<0>>),
         {row, index} <- Enum.find(@table, fn {row, _index} -> row.name == name end) do
      {row, index, rest}
    else
      _unknown -> :error
    end
  end
end
