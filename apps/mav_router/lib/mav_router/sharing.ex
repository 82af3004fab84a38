defmodule MavRouter.Sharing do
  @moduledoc """
  What the ground stations of one vehicle share: the rates of its messages, what was read of it, and whose turn a
  transfer is. Each of the three looks at the frames of a delivery and keeps those that must not go on, or not yet.
  """

  alias MavRouter.Forward.Delivery
  alias MavRouter.Sharing.ReadCache
  alias MavRouter.Sharing.StreamRequests
  alias MavRouter.Sharing.TransferLock

  @doc """
  The delivery with the frames that go on now. What somebody says in the name of another one's vehicle is nobody's
  request.
  """
  @spec pass(Delivery.t()) :: Delivery.t()
  def pass(%{source: %{standing: :claim}} = delivery), do: delivery

  def pass(delivery) do
    delivery
    |> StreamRequests.pass()
    |> ReadCache.pass()
    |> TransferLock.pass()
  end
end
