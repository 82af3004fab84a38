defmodule SimVehicle.Msp.Blocks do
  @moduledoc "What a simulated flight controller says of its configuration: what the real one said in its simulator (`priv/msp`), and what was written since."

  alias MavCodec.Msp.{Message, Messages, Payload}

  @priv Path.expand("../../../priv/msp", __DIR__)
  @blocks (for firmware <- [:betaflight, :inav], into: %{} do
             path = Path.join(@priv, "#{firmware}.txt")
             @external_resource path
             lines =
               for line <- File.stream!(path), not String.starts_with?(line, "#"), do: String.split(line)

             bytes = fn hex -> if hex == "-", do: "", else: Base.decode16!(hex, case: :lower) end
             {firmware, Map.new(lines, fn [id, hex] -> {String.to_integer(id), bytes.(hex)} end)}
           end)

  @typedoc "Payloads by message id."
  @type t :: %{(id :: non_neg_integer) => binary}

  @doc "Those of a new one."
  @spec new(Messages.firmware()) :: t
  def new(firmware), do: Map.fetch!(@blocks, firmware)

  @doc "After a write: it changes the fields that it shares with the read of its name; one without such a read changes nothing here."
  @spec write(t, Messages.firmware(), Message.version(), Message.t(), binary) :: t
  def write(blocks, firmware, version, message, payload) do
    with {:ok, %{id: id, reply: [_ | _] = layout}} <-
           Messages.fetch(firmware, String.replace(message.name, "SET_", "")),
         %{^id => block} <- blocks,
         {:ok, new} <- Payload.decode(message.request, payload, version),
         {:ok, old} <- Payload.decode(layout, block, version),
         {:ok, block} <- Payload.encode(layout, Map.merge(old, Map.take(new, Map.keys(old))), version) do
      Map.put(blocks, id, block)
    else
      _acknowledged_only -> blocks
    end
  end
end
