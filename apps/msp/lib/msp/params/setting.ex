defmodule Msp.Params.Setting do
  @moduledoc "Settings of iNav: what COMMON_SETTING_INFO says of one, and a value as it is written."

  import Bitwise

  @lookup 0x40
  @types %{0 => :u8, 1 => :i8, 2 => :u16, 3 => :i16, 4 => :u32, 5 => :f32}

  @enforce_keys [:name, :type, :low, :high, :index, :value]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          name: String.t(),
          type: :u8 | :i8 | :u16 | :i16 | :u32 | :f32,
          low: integer,
          high: integer,
          index: non_neg_integer,
          value: number
        }

  @doc "The request's name: of a setting by its name, or by its number."
  @spec request(String.t() | non_neg_integer) :: binary
  def request(name) when is_binary(name), do: name <> <<0>>
  def request(index), do: <<0, index::16-little>>

  @doc "The setting of a reply; `:text` for one that is not a number."
  @spec read(map) :: {:ok, t} | :text | :error
  def read(%{name: name, type: type, mode: mode, min: low, max: high, index: index, table_and_value: rest}) do
    # Behind the words for the values.
    words = if (mode &&& @lookup) != 0, do: high - low + 1, else: 0

    with {:ok, type} <- Map.fetch(@types, type),
         {:ok, bytes} <- skip(rest, words),
         {:ok, value} <- number(type, bytes) do
      {:ok, %__MODULE__{name: name, type: type, low: low, high: high, index: index, value: value}}
    else
      :error when is_map_key(@types, type) -> :error
      :error -> :text
    end
  end

  def read(_short), do: :error

  defp skip(bytes, words) when words <= 0, do: {:ok, bytes}

  defp skip(bytes, words) do
    case :binary.split(bytes, <<0>>) do
      [_word, rest] -> skip(rest, words - 1)
      [_no_end] -> :error
    end
  end

  defp number(:u8, <<n, _::binary>>), do: {:ok, n}
  defp number(:i8, <<n::signed, _::binary>>), do: {:ok, n}
  defp number(:u16, <<n::16-little, _::binary>>), do: {:ok, n}
  defp number(:i16, <<n::16-little-signed, _::binary>>), do: {:ok, n}
  defp number(:u32, <<n::32-little, _::binary>>), do: {:ok, n}
  defp number(:f32, <<n::32-little-float, _::binary>>), do: {:ok, n}
  defp number(_type, _short), do: :error

  @doc "The payload that sets it; why not, if the value does not fit. Firmware checks the upper limit only."
  @spec write(t, number) :: {:ok, binary} | {:error, String.t()}
  def write(setting, value) do
    cond do
      setting.type != :f32 and value != round(value) ->
        {:error, "it is a whole number"}

      value < setting.low or value > setting.high ->
        {:error, "it goes from #{setting.low} to #{setting.high}"}

      true ->
        {:ok, request(setting.name) <> bytes(setting.type, value)}
    end
  end

  defp bytes(:f32, value), do: <<value * 1.0::32-little-float>>
  defp bytes(type, value) when type in [:u8, :i8], do: <<round(value)>>
  defp bytes(type, value) when type in [:u16, :i16], do: <<round(value)::16-little>>
  defp bytes(:u32, value), do: <<round(value)::32-little>>
end
