defmodule Aerie.Router.Renumber do
  @moduledoc """
  System ids of a network shown to a client with a number added: all vehicles of a hub with many radios have id 1, and one
  ground station is to see them all at once.

  It breaks R3 (forwarded bytes are never changed), so it is done for clients that ask for it (`id_offsets`) and for those
  networks only; what passes between vehicles, to sessions and to other clients is as it was received.

  | what | on its way to the client | on its way to the vehicle |
  |---|---|---|
  | source | of 1 to #{239}, but for a SiK radio's own reports (51/68): plus the offset | as it is |
  | `target_system` | of 1 to #{239}, unless that is somebody at the client's end: plus the offset | less the offset, where there is such a system |
  | the rest of the payload | as it is: an id in a parameter of a command (the leader to follow, say) is not found out | |
  | CRC | corrected by what the change makes of it, so that a frame that was wrong stays wrong | the same |

  Not possible, so refused and counted (`refused` at the client's end): signed frames (the signature covers the ids),
  32-bit ids, and what would come out above #{239}. Ids from 240 on are ground stations' and this gateway's own.
  """

  import Bitwise

  alias Aerie.Router.Plan.Way
  alias MavCodec.CRC
  alias MavCodec.Dialects.All
  alias MavCodec.Frame

  @highest 239
  @long_ids 0x06

  @typedoc "By network; those that are not there are shown as they are."
  @type t :: %{String.t() => pos_integer} | nil

  @doc "Checks offsets; the error is words. None: nil."
  @spec compile(%{String.t() => non_neg_integer} | nil) :: {:ok, t} | {:error, String.t()}
  def compile(nil), do: {:ok, nil}

  def compile(offsets) when is_map(offsets) do
    case Enum.find(offsets, fn {name, n} ->
           not (is_binary(name) and is_integer(n) and n in 0..(@highest - 1))
         end) do
      nil ->
        kept = Map.reject(offsets, fn {_name, n} -> n == 0 end)
        {:ok, if(kept == %{}, do: nil, else: kept)}

      wrong ->
        {:error, "#{inspect(wrong, limit: 5)} is no network with a number of 0 to #{@highest - 1}"}
    end
  end

  def compile(other), do: {:error, "networks with numbers, not #{inspect(other, limit: 5)}"}

  @doc "The id under which a client with these offsets sees a system of a network."
  @spec seen(t, String.t(), non_neg_integer) :: non_neg_integer
  def seen(nil, _network, system), do: system
  def seen(offsets, network, system), do: shift(system, Map.get(offsets, network, 0))

  @doc "The system of a network that a client with these offsets means by an id; nil when it can mean none."
  @spec meant(t, String.t(), non_neg_integer) :: non_neg_integer | nil
  def meant(nil, _network, id), do: id
  def meant(_offsets, _network, id) when id > @highest or id == 0, do: id

  def meant(offsets, network, id) do
    case id - Map.get(offsets, network, 0) do
      system when system >= 1 -> system
      _below -> nil
    end
  end

  @doc """
  A vehicle's frame as the client sees it. `theirs?` tells whether a system is at the client's end. `:refused` for what
  cannot be changed.
  """
  @spec outward(t, Way.t(), Frame.t(), (non_neg_integer -> boolean)) :: {:ok, Frame.t()} | :refused
  def outward(offsets, %{networks: networks}, frame, theirs?) do
    case Enum.find_value(networks, 0, &offsets[&1]) do
      0 -> {:ok, frame}
      offset -> outward(frame, offset, theirs?)
    end
  end

  defp outward(%{system: 51, component: 68} = frame, _offset, _theirs?), do: {:ok, frame}

  defp outward(frame, offset, theirs?) do
    source = shift(frame.system, offset)

    target =
      case Frame.target(frame) do
        {system, _component} when system in 1..@highest ->
          if theirs?.(system), do: system, else: shift(system, offset)

        _nobody_or_a_station ->
          nil
      end

    change(frame, source, target)
  end

  defp shift(system, offset) when system in 1..@highest, do: system + offset
  defp shift(system, _offset), do: system

  @doc "A client's frame with this system as its addressee."
  @spec inward(Frame.t(), non_neg_integer) :: {:ok, Frame.t()} | :refused
  def inward(frame, system), do: change(frame, frame.system, system)

  # `nil` for a target that stays.
  defp change(frame, source, target) do
    changes =
      for {at, new} <- [{system_at(frame), source}, {target_at(frame), target}],
          at != nil and new != nil and :binary.at(frame.bytes, at) != new,
          do: {at, new}

    cond do
      changes == [] -> {:ok, frame}
      frame.signature != nil or (frame.incompat &&& @long_ids) != 0 -> :refused
      source > 255 or Enum.any?(changes, fn {_at, new} -> new > @highest end) -> :refused
      true -> {:ok, changed(frame, changes)}
    end
  end

  defp system_at(%{version: 1}), do: 3
  defp system_at(_v2), do: 5

  # Bytes that were cut off are zero, and nobody's id.
  defp target_at(frame) do
    case All.targets(frame.id) do
      {at, _component} when is_integer(at) and at < byte_size(frame.payload) -> header(frame) + at
      _none -> nil
    end
  end

  defp header(%{version: 1}), do: 6
  defp header(_v2), do: 10

  # The CRC is linear: what a change of bytes makes of it is the CRC, begun at 0, of the difference.
  defp changed(frame, changes) do
    crc_at = header(frame) + byte_size(frame.payload)
    {first, _new} = hd(changes)
    zeros = :binary.copy(<<0>>, crc_at - first + 1)

    difference =
      Enum.reduce(changes, zeros, fn {at, new}, bytes ->
        put(bytes, at - first, bxor(new, :binary.at(frame.bytes, at)))
      end)

    bytes = Enum.reduce(changes, frame.bytes, fn {at, new}, bytes -> put(bytes, at, new) end)
    <<head::binary-size(^crc_at), crc::16-little, rest::binary>> = bytes
    bytes = <<head::binary, bxor(crc, CRC.x25(difference, 0))::16-little, rest::binary>>
    Frame.from_bytes(bytes, frame.crc_extra, frame.at)
  end

  defp put(bytes, at, byte) do
    <<before::binary-size(^at), _old, rest::binary>> = bytes
    <<before::binary, byte, rest::binary>>
  end
end
