defmodule Msp.Listing do
  @moduledoc """
  A recorded line with MSP for people: its entries (`MavCodec.Msp.Trace`) as requests, replies and MAVLink messages with their names and values.

  How a message is to be read depends on the firmware and its version, which the recording says where the line was opened. Before that a
  message has its name, if all firmwares have the same, and its payload.
  """

  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Frame, Messages, Parser, Trace}
  alias Msp.{Firmware, Identity}

  defstruct parsers: %{}, found: %{}, target: nil

  @type t :: %__MODULE__{parsers: map, found: map, target: MavCodec.Msp.Guard.target() | nil}

  @typedoc """
  - `from`: `:gateway`, `:vehicle` or a program's number
  - `what`: `:opened`, `:closing`, `:request`, `:reply`, `:refusal`, `:mavlink`, `:joined`, `:left`, `:allowed`, `:denied`
  - `name`: of a message, or its number as text; `values`: nil where they cannot be read, with the `payload` instead
  """
  @type line :: %{
          from: :gateway | :vehicle | pos_integer,
          what: atom,
          name: String.t() | nil,
          values: map | nil,
          payload: binary | nil
        }

  @about %{1 => "API_VERSION", 2 => "FC_VARIANT", 3 => "FC_VERSION"}

  @doc "Nothing was read yet."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "What an entry says."
  @spec lines(t, Trace.entry()) :: {[line], t}
  def lines(listing, {_now, :opened}), do: {[line(:gateway, :opened)], %{new() | target: listing.target}}
  def lines(listing, {_now, :closing}), do: {[line(:gateway, :closing)], listing}
  def lines(listing, {_now, :tick}), do: {[], listing}
  def lines(listing, {_now, {:client, id, :up}}), do: {[line(id, :joined)], listing}

  def lines(listing, {_now, {:client, id, :down}}),
    do: {[line(id, :left)], %{listing | parsers: Map.delete(listing.parsers, id)}}

  def lines(listing, {_now, {:judged, id, allowed?}}),
    do: {[line(id, if(allowed?, do: :allowed, else: :denied))], listing}

  def lines(listing, {_now, {:client, id, bytes}}), do: frames(listing, id, bytes)
  def lines(listing, {_now, {:written, bytes}}), do: frames(listing, :gateway, bytes)
  def lines(listing, {_now, {:bytes, bytes}}), do: frames(listing, :vehicle, bytes)
  def lines(listing, {_now, {:mavlink, bytes}}), do: {messages(bytes), listing}

  defp frames(listing, from, bytes) do
    {frames, parser} = Parser.push(Map.get(listing.parsers, from, Parser.new()), bytes)
    listing = %{listing | parsers: Map.put(listing.parsers, from, parser)}

    Enum.map_reduce(frames, listing, fn frame, listing ->
      listing = learn(listing, frame)
      {frame(listing, from, frame), listing}
    end)
  end

  defp frame(listing, from, %{direction: direction, id: id} = frame) do
    what = %{request: :request, reply: :reply, error: :refusal}[direction]

    target = if is_map_key(@about, id), do: Firmware.any(), else: listing.target

    case target && MavCodec.Msp.decode(frame, target) do
      {:ok, values} -> line(from, what, name(target, id), values)
      _unknown -> %{line(from, what, name(listing.target, id)) | payload: frame.payload}
    end
  end

  defp name({firmware, _version}, id) do
    case Messages.fetch(firmware, id) do
      {:ok, message} -> message.name
      :error -> to_string(id)
    end
  end

  defp name(nil, id) do
    case Messages.firmwares() |> Enum.map(&name({&1, nil}, id)) |> Enum.uniq() do
      [same] -> same
      _differ -> to_string(id)
    end
  end

  # After each restart the vehicle is identified again.
  defp learn(%{found: found} = listing, %Frame{direction: :reply, id: id} = frame)
       when is_map_key(@about, id) do
    case MavCodec.Msp.decode(frame, Firmware.any()) do
      {:ok, values} -> recognise(%{listing | found: Map.put(found, @about[id], values)})
      {:error, _damaged} -> listing
    end
  end

  defp learn(listing, _frame), do: listing

  defp recognise(%{found: found} = listing) do
    with %{"API_VERSION" => %{api_major: major, api_minor: minor}, "FC_VARIANT" => %{variant: variant}} <-
           found,
         {:ok, identity} <- Identity.of({major, minor}, variant, found["FC_VERSION"]) do
      %{listing | target: Identity.target(identity)}
    else
      _not_yet_or_no_vehicle -> listing
    end
  end

  defp messages(bytes) do
    {frames, _parser} = MavCodec.Parser.push(MavCodec.Parser.new(), bytes, 0)

    for frame <- frames do
      case MavCodec.decode(frame) do
        {:ok, %module{} = message} ->
          line(:gateway, :mavlink, MavCodec.Dialects.All.name(module.id()), values(message))

        {:error, _damaged} ->
          %{line(:gateway, :mavlink, to_string(frame.id)) | payload: frame.payload}
      end
    end
  end

  # The number that the bytes are.
  defp values(%M.ParamSet{param_value: wire, param_type: type} = message) do
    case ParamValue.asked(wire, type, :bytewise) do
      {:ok, value} -> Map.from_struct(%{message | param_value: value})
      {:error, _why} -> Map.from_struct(message)
    end
  end

  defp values(message), do: Map.from_struct(message)

  defp line(from, what, name \\ nil, values \\ nil),
    do: %{from: from, what: what, name: name, values: values, payload: nil}
end
