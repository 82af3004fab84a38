defmodule MavRouter.Endpoints.Owner.Renumber do
  @highest 239

  @moduledoc """
  Adds a number to the system ids of a network for one client: the vehicles of a hub with many radios may all have id 1, and one
  ground station is to see them all.

  This breaks R3 (forwarded bytes are never changed), so it is done only for clients that ask for it (`id_offsets`), and for the
  networks that they name. Frames between vehicles, to sessions and to other clients are as they were received.

  | what | on its path to the client | on its path to the vehicle |
  |---|---|---|
  | source | of 1 to #{@highest}, except a SiK radio's own reports (51/68): plus the offset | unchanged |
  | `target_system` | of 1 to #{@highest}, unless that system is at the client's end: plus the offset | less the offset, where there is such a system |
  | the rest of the payload | unchanged: an id in a parameter of a command (the leader to follow, say) is not recognised | the same |
  | CRC | corrected by the difference, so that a wrong CRC stays wrong | the same |

  Signed frames (the signature covers the ids), 32-bit ids and ids that would exceed #{@highest} cannot be renumbered: such frames are
  refused and counted at the client (`refused`). Higher ids are those of ground stations and of this gateway.
  """

  import Bitwise

  alias Aerie.Base.Json
  alias MavRouter.Forward.Table.Path
  alias MavCodec.CRC
  alias MavCodec.Dialects.All
  alias MavCodec.Frame

  @long_ids 0x06

  @typedoc "Offsets by network; the others have none."
  @type t :: %{String.t() => pos_integer} | nil

  @doc "Checks offsets, nil for none; the error is a text."
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
        {:error, "#{Json.shown(Map.new([wrong]), 60)} is not a network with a number of 0 to #{@highest - 1}"}
    end
  end

  def compile(other), do: {:error, "expected networks with numbers, not #{Json.shown(other, 60)}"}

  @doc "The id that a client with these offsets sees for a system of a network."
  @spec seen(t, String.t(), non_neg_integer) :: non_neg_integer
  def seen(nil, _network, system), do: system
  def seen(offsets, network, system), do: shift(system, Map.get(offsets, network, 0))

  @doc "The system of a network that a client with these offsets means by an id; nil for none."
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
  A vehicle's frame as the client sees it, or `:refused`. `theirs?` tells whether a system is at the client's end.
  """
  @spec outward(t, Path.t(), Frame.t(), (non_neg_integer -> boolean)) :: {:ok, Frame.t()} | :refused
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

        _none_or_a_station ->
          nil
      end

    change(frame, source, target)
  end

  defp shift(system, offset) when system in 1..@highest, do: system + offset
  defp shift(system, _offset), do: system

  @doc "A client's frame with this system as its target."
  @spec inward(Frame.t(), non_neg_integer) :: {:ok, Frame.t()} | :refused
  def inward(frame, system), do: change(frame, frame.system, system)

  # A target of nil stays as it is.
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

  # Bytes that were cut off are zero, which is not an id.
  defp target_at(frame) do
    case All.targets(frame.id) do
      {at, _component} when is_integer(at) and at < byte_size(frame.payload) -> header(frame) + at
      _none -> nil
    end
  end

  defp header(%{version: 1}), do: 6
  defp header(_v2), do: 10

  # The CRC is linear: a change of bytes changes it by the CRC of the difference, computed from 0.
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
