defmodule MavCodec.Msp.Trace do
  @component 242
  @payload_type 41_080
  @most_parts 4_096

  @moduledoc """
  What went over a line with MSP, in a recording of MAVLink frames: entries `{time, what}` as TUNNEL frames, which every ground station
  skips.

  An entry is what a session was given (`t:what/0`), or what it wrote to the flight controller, at microseconds of the clock that it
  was given. It has one frame or several: TUNNEL of payload type #{@payload_type} by component #{@component}, with this payload:

      kind, last (1 or 0), part u16, time i64, up to 116 bytes      (little-endian)

  `push/2` puts them together again. An entry of which a frame is missing is left out.
  """

  alias MavCodec.Frame
  alias MavCodec.Frame.Splitter
  alias MavCodec.Signing.Redact
  alias MavCodec.Messages.Tunnel

  @tunnel Tunnel.id()
  @chunk 116
  @whole 133
  @kinds [
    opened: 1,
    bytes: 2,
    mavlink: 3,
    tick: 4,
    up: 5,
    down: 6,
    client: 7,
    judged: 8,
    closing: 9,
    written: 10
  ]
  @names Map.new(@kinds, fn {name, kind} -> {kind, name} end)

  @typedoc "What a session was given; `{:written, bytes}` to the flight controller."
  @type what ::
          :opened
          | :tick
          | :closing
          | {:bytes | :mavlink | :written, binary}
          | {:client, non_neg_integer, :up | :down | binary}
          | {:judged, non_neg_integer, boolean}
  @type entry :: {time_us :: integer, what}
  @typedoc "The entry that is being put together, nil for none."
  @type t :: nil | {kind :: byte, time_us :: integer, next :: pos_integer, [binary]}

  @doc "How many frames an entry takes, without making them."
  @spec count(what) :: pos_integer
  def count({:mavlink, bytes}), do: count({:bytes, bytes})
  def count(what), do: max(div(byte_size(data(what)) + @chunk - 1, @chunk), 1)

  @doc """
  The frames of an entry. `system` is the vehicle's id, `seq` the number of the first frame, `at` when the entry was recorded (unix
  microseconds). MAVLink frames lose keys and signatures, as in every recording (S9).
  """
  @spec frames(entry, system: byte, seq: non_neg_integer, at: integer) :: [Frame.t()]
  def frames({time, what}, options) do
    parts = what |> data() |> chunks()
    last = length(parts) - 1

    for {part, n} <- Enum.with_index(parts) do
      ending = if n == last, do: 1, else: 0
      payload = <<kind(what), ending, n::16-little, time::64-little-signed, part::binary>>
      tunnel = %Tunnel{payload_type: @payload_type, payload_length: byte_size(payload), payload: payload}

      tunnel
      |> MavCodec.encode(system: options[:system], component: @component, seq: options[:seq] + n)
      |> Frame.from_bytes(nil, options[:at])
      |> Splitter.checked()
    end
  end

  @doc "Whether a frame belongs to an entry: nothing that a vehicle said."
  @spec frame?(Frame.t()) :: boolean
  def frame?(%Frame{id: @tunnel, component: @component, payload: <<@payload_type::16-little, _::binary>>}),
    do: true

  def frame?(_frame), do: false

  @doc "The next frame of a recording, and the entry that it completes."
  @spec push(t, Frame.t()) :: {entry | nil, t}
  def push(open, frame) do
    with true <- frame?(frame),
         <<_type::16, _target::16, size, payload::binary-size(size), _::binary>> when size >= 12 <-
           whole(frame.payload) do
      <<kind, last, n::16-little, time::64-little-signed, part::binary>> = payload
      part(open, kind, last, n, time, part)
    else
      _no_part -> {nil, open}
    end
  end

  # Zeros at the end were cut off (F7).
  defp whole(payload), do: payload <> :binary.copy(<<0>>, max(@whole - byte_size(payload), 0))

  defp part(_none, kind, last, 0, time, part), do: complete({kind, time, 1, [part]}, last)

  defp part({kind, time, n, parts}, kind, last, n, time, part) when n < @most_parts,
    do: complete({kind, time, n + 1, [part | parts]}, last)

  defp part(_other, _kind, _last, _n, _time, _part), do: {nil, nil}

  defp complete(open, 0), do: {nil, open}

  defp complete({kind, time, _n, parts}, _last) do
    case what(@names[kind], parts |> Enum.reverse() |> IO.iodata_to_binary()) do
      nil -> {nil, nil}
      what -> {{time, what}, nil}
    end
  end

  defp kind({:client, _id, :up}), do: @kinds[:up]
  defp kind({:client, _id, :down}), do: @kinds[:down]
  defp kind(what) when is_atom(what), do: @kinds[what]
  defp kind(what), do: @kinds[elem(what, 0)]

  defp data({:mavlink, bytes}), do: public(bytes)
  defp data({:client, id, bytes}) when is_binary(bytes), do: <<id::32-little, bytes::binary>>
  defp data({:client, id, _up_or_down}), do: <<id::32-little>>
  defp data({:judged, id, allowed?}), do: <<id::32-little, if(allowed?, do: 1, else: 0)>>
  defp data({_name, bytes}), do: bytes
  defp data(_no_bytes), do: ""

  defp public(bytes) do
    {frames, rest} = Splitter.frames(bytes)

    IO.iodata_to_binary([
      for(frame <- frames, do: Redact.frame(Splitter.checked(frame), signatures: false).bytes),
      rest
    ])
  end

  defp what(name, "") when name in [:opened, :tick, :closing], do: name
  defp what(name, bytes) when name in [:bytes, :mavlink, :written], do: {name, bytes}
  defp what(name, <<id::32-little>>) when name in [:up, :down], do: {:client, id, name}
  defp what(:client, <<id::32-little, bytes::binary>>), do: {:client, id, bytes}
  defp what(:judged, <<id::32-little, allowed>>) when allowed in 0..1, do: {:judged, id, allowed == 1}
  defp what(_unknown, _bytes), do: nil

  defp chunks(bytes) when byte_size(bytes) <= @chunk, do: [bytes]
  defp chunks(<<part::binary-size(@chunk), rest::binary>>), do: [part | chunks(rest)]
end
