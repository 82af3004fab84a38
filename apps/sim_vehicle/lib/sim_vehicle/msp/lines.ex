defmodule SimVehicle.Msp.Lines do
  @window 510

  @moduledoc """
  Settings of Betaflight 2026.6 by name, as lines of its command line, with the firmware's rules: a reading needs as many NULs behind the name as the
  answer has characters and three, names are found whatever the case of their letters, values outside of the range, unknown words and empty ones are
  refused, and what is written into a request shorter than its line is done, with an empty reply. Descriptions come in windows of #{@window} bytes.
  """

  alias MavCodec.Msp.{Messages, Params, Payload}

  @version {1, 48}
  @rows Params.all(:betaflight, @version)
  @types %{"u8" => "uint8", "i8" => "int8", "u16" => "uint16", "i16" => "int16", "u32" => "uint32"}
  # Text has no row in the table.
  @text "craft_name"

  @doc "The settings that are in no block, at their defaults."
  @spec new() :: %{String.t() => integer | String.t()}
  def new do
    @rows
    |> Function.identity()
    |> Enum.filter(&(&1.block == nil))
    |> Map.new(&{&1.name, &1.default || &1.low})
    |> Map.put(@text, "-")
  end

  @doc "The reply to MSP2_CLI_SETTING or MSP2_CLI_SETTING_INFO, and what changes."
  @spec answer(map, 0x3010 | 0x3011, binary) :: {:ok, binary, map} | :error
  def answer(_fc, 0x3011, request) do
    with [name, rest] <- :binary.split(request, <<0>>), {:ok, row} <- find(name) do
      offset = with <<offset::16-little, _::binary>> <- rest, do: offset, else: (_none -> 0)
      text = describe(row)
      size = byte_size(text)
      window = binary_part(text, min(offset, size), min(@window, max(size - offset, 0)))
      {:ok, <<size::16-little, window::binary>>, %{}}
    else
      _unknown -> :error
    end
  end

  def answer(fc, 0x3010, request) do
    case :binary.split(request, "=") do
      [name, value] ->
        set(fc, String.trim(name), value |> String.trim_trailing(<<0>>) |> String.trim(), byte_size(request))

      [_reading] ->
        get(fc, request)
    end
  end

  defp get(fc, request) do
    with [name, _nuls] <- :binary.split(request, <<0>>),
         {:ok, row} <- find(name),
         value = shown(row, value(fc, row)),
         true <- byte_size(request) - byte_size(name) >= 3 + byte_size(value) do
      {:ok, "#{row.name} = #{value}", %{}}
    else
      _unknown_or_short -> :error
    end
  end

  defp set(fc, name, text, size) do
    with {:ok, row} <- find(name), {:ok, value} <- parse(row, text) do
      line = "#{row.name} = #{shown(row, value)}"
      {:ok, if(size < byte_size(line), do: "", else: line), put(fc, row, value)}
    end
  end

  defp find(name) do
    name = String.downcase(name, :ascii)

    case Enum.find(Function.identity(@rows), &(&1.name == name)) do
      nil when name == @text -> {:ok, %{name: @text, block: nil, type: "string", values: []}}
      nil -> :error
      row -> {:ok, row}
    end
  end

  defp describe(%{type: "string"}),
    do: lines(pgn: 47, type: "string", minlength: 1, maxlength: 16, default: "-")

  defp describe(%{values: [_ | _] = words}),
    do: lines(pgn: 1, type: "lookup", values: Enum.join(words, ","), default: hd(words))

  defp describe(row) do
    {low, high} = range(row)
    lines(pgn: 1, type: @types[type(row)], min: low, max: high, default: row.default || low)
  end

  defp lines(fields), do: Enum.map_join(fields, "\n", fn {key, value} -> "#{key}=#{value}" end)

  defp range(%{low: low, high: high}) when low != nil, do: {low, high}
  defp range(row), do: if(type(row) in ["i8", "i16"], do: {-100, 100}, else: {0, 200})

  defp type(%{block: nil, type: type}), do: type
  defp type(row), do: row |> field() |> Map.fetch!(:type) |> to_string()

  defp field(row), do: Enum.find(layout(row), &(is_map_key(&1, :key) and &1.key == row.field))

  defp layout(row) do
    {:ok, message} = Messages.fetch(:betaflight, row.block)
    message.reply
  end

  defp id(row) do
    {:ok, message} = Messages.fetch(:betaflight, row.block)
    message.id
  end

  defp value(fc, %{block: nil, name: name}), do: Map.fetch!(fc.settings, name)

  defp value(fc, row) do
    with %{} = values <- block(fc, row), number when number != nil <- values[row.field] do
      div(number - row.base, row.step)
    else
      _older_block -> row.default || 0
    end
  end

  defp block(fc, row) do
    with {:ok, bytes} <- Map.fetch(fc.blocks, id(row)),
         {:ok, values} <- Payload.decode(layout(row), bytes, @version),
         do: values
  end

  defp put(fc, %{block: nil, name: name}, value), do: %{settings: Map.put(fc.settings, name, value)}

  defp put(fc, row, value) do
    with %{} = values when is_map_key(values, row.field) <- block(fc, row),
         changed = Map.put(values, row.field, row.base + row.step * value),
         {:ok, bytes} <- Payload.encode(layout(row), changed, @version) do
      %{blocks: Map.put(fc.blocks, id(row), bytes)}
    else
      _older_block -> %{}
    end
  end

  defp shown(%{values: [_ | _] = words}, value), do: Enum.at(words, value) || "#{value}"
  defp shown(_row, value), do: "#{value}"

  defp parse(%{type: "string"}, text), do: if(byte_size(text) in 1..16, do: {:ok, text}, else: :error)

  defp parse(%{values: [_ | _] = words}, text) do
    with nil <- Enum.find_index(words, &(String.upcase(&1) == String.upcase(text))),
         do: :error,
         else: (index -> {:ok, index})
  end

  defp parse(row, text) do
    {low, high} = range(row)

    case Integer.parse(text) do
      {value, ""} when value >= low and value <= high -> {:ok, value}
      _other -> :error
    end
  end
end
