defmodule Msp.Session.Output do
  @moduledoc "What a session tells in MAVLink: messages of the vehicle's autopilot, in the order of their sending."

  alias MavCodec.{Dialects, Frame}
  alias MavCodec.Frame.Encoder
  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias Msp.Session

  @results Map.new(
             [:ACCEPTED, :TEMPORARILY_REJECTED, :DENIED, :UNSUPPORTED, :FAILED, :IN_PROGRESS],
             &{&1, MavResult.value(:"MAV_RESULT_#{&1}")}
           )
  # STATUSTEXT
  @chunk 50

  @enforce_keys [:encoder]
  defstruct [:encoder, texts: 0, frames: []]

  @typedoc "`texts`: how many were sent; `frames`: those since the last `take/1`, the last one first."
  @type t :: %__MODULE__{encoder: Encoder.t(), texts: non_neg_integer, frames: [Frame.t()]}

  @doc "Nothing was sent by the vehicle with this id."
  @spec new(system :: 1..254) :: t
  def new(system), do: %__MODULE__{encoder: Encoder.new(system: system, component: 1)}

  @doc "Sends messages."
  @spec emit(Session.t(), struct | [struct]) :: Session.t()
  def emit(session, messages) when is_list(messages), do: Enum.reduce(messages, session, &emit(&2, &1))

  def emit(%{output: output} = session, message) do
    {bytes, encoder} = Encoder.encode(output.encoder, message)
    frame = Frame.from_bytes(bytes, Dialects.All.crc_extra(message.__struct__.id()))
    %{session | output: %{output | encoder: encoder, frames: [frame | output.frames]}}
  end

  @doc "Sends a text, in several chunks if it is long."
  @spec text(Session.t(), severity :: 0..7, String.t()) :: Session.t()
  def text(session, severity, text) do
    chunks = chunks(text)
    texts = session.output.texts + 1
    id = if length(chunks) > 1, do: rem(texts, 0xFFFF) + 1, else: 0

    messages =
      for {chunk, n} <- Enum.with_index(chunks),
          do: %M.Statustext{severity: severity, text: chunk, id: id, chunk_seq: n}

    put_in(session.output.texts, texts) |> emit(messages)
  end

  defp chunks(text) when byte_size(text) <= @chunk, do: [text]
  defp chunks(text), do: [binary_slice(text, 0, @chunk) | chunks(binary_slice(text, @chunk..-1//1))]

  @doc "COMMAND_ACK to a client."
  @spec acknowledge(Session.t(), integer, {byte, byte}, atom) :: Session.t()
  def acknowledge(session, command, {system, component}, result) do
    emit(session, %M.CommandAck{
      command: command,
      result: Map.fetch!(@results, result),
      target_system: system,
      target_component: component
    })
  end

  @doc "What was sent since the last call, as one action."
  @spec take(Session.t()) :: {[{:frames, [Frame.t(), ...]}], Session.t()}
  def take(%{output: %{frames: []}} = session), do: {[], session}

  def take(%{output: %{frames: frames}} = session),
    do: {[{:frames, Enum.reverse(frames)}], put_in(session.output.frames, [])}

  @doc "The vehicle's clock in milliseconds since its start, as far as that is known. It begins again after 2^32 ms, as MAVLink's does."
  @spec boot_ms(Session.t(), integer) :: 0..0xFFFFFFFF
  def boot_ms(%{boot: boot}, now), do: (now - boot) |> div(1000) |> max(0) |> Bitwise.band(0xFFFFFFFF)
end
