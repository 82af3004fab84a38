defmodule MavCodec.Msp.Guard do
  @max_payload 192
  @max_multiple_reply 250

  @moduledoc """
  Which requests may be written to a flight controller at all, from anyone: what is let through here harms no firmware. Who may
  send what is decided elsewhere.

  - A payload has at most #{@max_payload} bytes: Betaflight before API 1.48 overwrites its memory with more.
  - A message must be in the table of the firmware, for its version. Another one may be a write.
  - An id above 254 needs version 2: version 1 would cut it to another message.
  - A write must end where the firmware expects it: what is missing it fills with what happens to be in its buffer, or
    with zeros. One that says itself how
    long it is (a count, a text's length) must have that and nothing more, and no list is empty: a count of 0 ends some
    firmware.
  - An order of motors names each of them once.
  - MULTIPLE_MSP (230) may only name telemetry whose replies fit in #{@max_multiple_reply} bytes together. Before API 1.48 it carries out
    writes, with arguments that nobody sent, and it overruns its buffer.
  - Passthrough, boot loaders, and what the table says is never sent, are refused.

  Bytes outside frames are never written either: `#` opens the command line, and `R` starts a boot loader.
  """

  alias MavCodec.Msp.{Field, Frame, Message, Messages, Payload}

  # The longest reply of each message that MULTIPLE_MSP may name, in bytes.
  @multiple %{
    101 => 27,
    102 => 18,
    104 => 16,
    105 => 36,
    106 => 18,
    107 => 5,
    108 => 6,
    109 => 6,
    110 => 9,
    128 => 24,
    129 => 50,
    130 => 11,
    150 => 27,
    167 => 8,
    247 => 9
  }
  @reboot 68
  @osd_config 85
  @most_motors 8
  @multiple_msp 230

  @typedoc "Which firmware, and which version of it, or nil if that is unknown."
  @type target :: {Messages.firmware(), Message.version() | nil}

  @doc "What MULTIPLE_MSP may name, with the longest reply of each in bytes."
  @spec multiple() :: %{(id :: byte) => pos_integer}
  def multiple, do: @multiple

  @doc """
  The message of a request that may be sent, or why it may not.

      iex> frame = %MavCodec.Msp.Frame{id: 202, payload: <<45, 80, 30>>}
      iex> MavCodec.Msp.Guard.check(frame, {:betaflight, {1, 46}})
      {:error, "SET_PID with 3 bytes: the firmware would make up the rest; it takes 15"}
  """
  @spec check(Frame.t(), target) :: {:ok, Message.t()} | {:error, String.t()}
  def check(%Frame{direction: direction}, _target) when direction != :request,
    do: {:error, "it is not a request"}

  def check(%Frame{payload: payload}, _target) when byte_size(payload) > @max_payload,
    do:
      {:error,
       "#{byte_size(payload)} bytes of payload: flight controllers take #{@max_payload}, and some crash with more"}

  def check(%Frame{form: :v1, id: id}, _target) when id > 254,
    do: {:error, "message #{id} needs version 2: in version 1 it would become #{rem(id, 256)}"}

  def check(%Frame{id: id, payload: payload}, {firmware, version}) do
    with {:ok, message} <- known(firmware, version, id),
         :ok <- never(message),
         :ok <- special(id, firmware, payload),
         :ok <- length(message, byte_size(payload)),
         :ok <- announced(message, payload, version),
         :ok <- content(message, payload),
         do: {:ok, message}
  end

  defp known(firmware, version, id) do
    with {:ok, message} <- Messages.fetch(firmware, id),
         true <- Message.in?(message, version) do
      {:ok, message}
    else
      _unknown -> {:error, "message #{id} is not known of this firmware"}
    end
  end

  defp never(%{never: nil}), do: :ok
  defp never(message), do: {:error, "#{message.name} is never sent: #{message.never}"}

  defp special(@reboot, _firmware, <<mode, _::binary>>) when mode != 0,
    do: {:error, "REBOOT into a boot loader or mass storage: the vehicle would be gone"}

  defp special(@multiple_msp, :betaflight, ids) do
    ids = :binary.bin_to_list(ids)

    cond do
      ids == [] ->
        {:error, "MULTIPLE_MSP names no message"}

      id = Enum.find(ids, &(not is_map_key(@multiple, &1))) ->
        {:error, "MULTIPLE_MSP with message #{id}: only telemetry is safe in it"}

      multiple_size(ids) > @max_multiple_reply ->
        {:error, "MULTIPLE_MSP: its reply may have more than #{@max_multiple_reply} bytes"}

      true ->
        :ok
    end
  end

  # By its first byte: general settings, a timer, or the place of an element.
  defp special(@osd_config, :betaflight, <<address::signed, _::binary>> = payload) do
    {least, most} = Map.get(%{-1 => {10, @max_payload}, -2 => {4, 4}}, address, {3, 4})
    size = byte_size(payload)

    if size in least..most,
      do: :ok,
      else: {:error, "SET_OSD_CONFIG #{address} with #{bytes(size)}: it takes #{least} to #{most}"}
  end

  defp special(_id, _firmware, _payload), do: :ok

  defp multiple_size(ids), do: ids |> Enum.map(&(1 + @multiple[&1])) |> Enum.sum()

  defp length(%{kind: :read}, _size), do: :ok

  defp length(message, size),
    do: if(fits?(message, size), do: :ok, else: {:error, wrong_length(message, size)})

  defp fits?(%{sizes: [_ | _] = sizes, exact?: exact?}, size),
    do: size in sizes or (not exact? and size > List.last(sizes))

  defp fits?(message, size),
    do:
      size >= message.min and (message.max == nil or size <= message.max) and
        (message.each == nil or rem(size, message.each) == 0)

  # What a payload says of its own length.
  defp announced(%{kind: :write, request: layout} = message, payload, version) do
    with true <- Enum.any?(layout, &announces?/1),
         {:error, why} <- whole(layout, Payload.decode(layout, payload, version), version),
         do: {:error, "#{message.name} with #{bytes(byte_size(payload))}: #{why}"},
         else: (_fits -> :ok)
  end

  defp announced(_read, _payload, _version), do: :ok

  defp announces?({:list, _key, count, _layout}), do: is_atom(count) and count != :rest
  defp announces?(%Field{type: type}), do: type == :pstr
  defp announces?(_optional), do: false

  defp whole(_layout, {:error, why}, _version), do: {:error, why}

  defp whole(_layout, {:ok, %{tail: tail}}, _version),
    do: {:error, "#{bytes(byte_size(tail))} more than it announces"}

  defp whole(layout, {:ok, values}, version) do
    Enum.find_value(layout, :ok, fn
      {:list, key, count, _layout} when is_atom(count) and count != :rest ->
        if values[key] in [nil, []], do: {:error, "#{count} is 0, or missing"}

      %Field{key: key} = field ->
        if Field.in?(field, version) and not is_map_key(values, key), do: {:error, "#{key} is missing"}

      _other ->
        nil
    end)
  end

  defp content(%{name: "MSP2_SET_MOTOR_OUTPUT_REORDERING"} = message, <<count, outputs::binary>>) do
    if count <= @most_motors and Enum.sort(:binary.bin_to_list(outputs)) == Enum.to_list(0..(count - 1)//1),
      do: :ok,
      else: {:error, "#{message.name}: it names each of at most #{@most_motors} motors once"}
  end

  defp content(_message, _payload), do: :ok

  defp wrong_length(%{sizes: [_ | _] = sizes} = message, size) do
    "#{message.name} with #{bytes(size)}: the firmware would make up the rest; it takes #{Enum.join(sizes, ", ")}"
  end

  defp wrong_length(message, size) do
    limits = [
      "at least #{message.min}",
      message.max && "at most #{message.max}",
      message.each && "a multiple of #{message.each}"
    ]

    "#{message.name} with #{bytes(size)}: it takes #{limits |> Enum.filter(& &1) |> Enum.join(", ")}"
  end

  defp bytes(1), do: "1 byte"
  defp bytes(n), do: "#{n} bytes"
end
