defmodule Msp.Params.Line do
  @longest_request 192
  @nuls 100

  @moduledoc """
  Settings of Betaflight by name (API 1.48): requests and replies of MSP2_CLI_SETTING and MSP2_CLI_SETTING_INFO, which are lines of its command line.

  A reading is the name and as many NULs as the answer has characters, at least: here #{@nuls}. A line with `=` is a write, so only names of letters, digits
  and underscores are asked for.
  """

  @name ~r/\A[A-Za-z0-9_]{1,64}\z/
  @types %{"uint8" => :u8, "int8" => :i8, "uint16" => :u16, "int16" => :i16, "uint32" => :u32}
  @chosen ~w(lookup bitset)

  @enforce_keys [:type, :low, :high]
  defstruct [:type, :low, :high, words: []]

  @typedoc "What is known of a setting that is a number: its range, and the words for its numbers from `low` on, if it has any."
  @type t :: %__MODULE__{
          type: :u8 | :i8 | :u16 | :i16 | :u32,
          low: integer,
          high: integer,
          words: [String.t()]
        }
  @type request :: {String.t(), map}

  @doc "Whether it may be the name of a setting."
  @spec name?(String.t()) :: boolean
  def name?(name), do: name =~ @name

  @doc "Asks what a setting is, from an offset in the answer's text on."
  @spec info(String.t(), non_neg_integer) :: request
  def info(name, offset),
    do: {"MSP2_CLI_SETTING_INFO", %{name_and_offset: name <> <<0, offset::16-little>>}}

  @doc "Asks for its value."
  @spec get(String.t()) :: request
  def get(name) do
    nuls = min(@nuls, @longest_request - byte_size(name))
    {"MSP2_CLI_SETTING", %{line: name <> :binary.copy(<<0>>, nuls)}}
  end

  @doc "The request that sets it; why not, if the value does not fit."
  @spec set(t, String.t(), number) :: {:ok, request} | {:error, String.t()}
  def set(line, name, value) do
    cond do
      value != round(value) -> {:error, "it is a whole number"}
      value < line.low or value > line.high -> {:error, "it goes from #{line.low} to #{line.high}"}
      true -> {:ok, {"MSP2_CLI_SETTING", %{line: "#{name} = #{written(line, round(value))}"}}}
    end
  end

  defp written(%{words: []}, value), do: Integer.to_string(value)
  defp written(%{words: words}, value), do: Enum.at(words, value)

  @doc "What the text of an answer to `info/2` says; `:text` of a setting that is not a number."
  @spec read(String.t()) :: {:ok, t} | :text | :error
  def read(text) do
    said =
      for line <- String.split(text, ["\n", "\r", <<0>>], trim: true),
          [key, value] <- [:binary.split(line, "=")],
          into: %{},
          do: {String.trim(key), String.trim(value)}

    case said do
      %{"type" => type, "values" => words} when type in @chosen and words != "" ->
        words = words |> String.split(",") |> Enum.map(&String.trim/1)
        {:ok, %__MODULE__{type: :u8, low: 0, high: length(words) - 1, words: words}}

      %{"type" => type, "min" => low, "max" => high} when is_map_key(@types, type) ->
        with {low, ""} <- Integer.parse(low), {high, ""} <- Integer.parse(high) do
          {:ok, %__MODULE__{type: @types[type], low: low, high: high}}
        else
          _no_numbers -> :error
        end

      %{"type" => _text_or_list} ->
        :text

      _other ->
        :error
    end
  end

  @doc "The value in an answer to `get/1`."
  @spec value(t, String.t(), String.t()) :: {:ok, integer} | :error
  def value(%{words: words}, name, text) do
    found =
      for line <- String.split(text, ["\n", "\r", <<0>>], trim: true),
          [key, value] <- [:binary.split(line, "=")],
          same?(String.trim(key), name),
          do: String.trim(value)

    case {found, words} do
      {[text | _], []} ->
        with {number, ""} <- Integer.parse(text), do: {:ok, number}, else: (_no_number -> :error)

      {[word | _], _words} ->
        with index when index != nil <- Enum.find_index(words, &same?(&1, word)),
             do: {:ok, index},
             else: (nil -> :error)

      {[], _words} ->
        :error
    end
  end

  defp same?(a, b), do: String.upcase(a, :ascii) == String.upcase(b, :ascii)
end
