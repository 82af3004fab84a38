defmodule MavCodec do
  @moduledoc """
  MAVLink wire formats as pure functions.
  """

  alias MavCodec.DecodeError
  alias MavCodec.Dialects

  @doc """
  Decodes a frame to its message struct.

  The frame is a `MavCodec.Frame`, or any map with `id`, `version` and `payload`. Truncated payloads are filled with
  zeros and surplus bytes ignored (F7-F9); only an id that is not in the dialect is an error.
  """
  @spec decode(
          %{:id => non_neg_integer(), :version => 1 | 2, :payload => binary(), optional(atom()) => term()},
          module()
        ) ::
          {:ok, struct()} | {:error, DecodeError.t()}
  def decode(frame, dialect \\ Dialects.All)

  def decode(%{version: 2, id: id, payload: payload}, dialect), do: dialect.decode(id, payload)

  # F9: there are no extensions in MAVLink 1, whatever follows the base fields.
  def decode(%{version: 1, id: id, payload: payload}, dialect) do
    case dialect.length(id) do
      {min, _max} when byte_size(payload) > min -> dialect.decode(id, binary_part(payload, 0, min))
      _length -> dialect.decode(id, payload)
    end
  end
end
