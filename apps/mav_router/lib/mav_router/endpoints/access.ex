defmodule MavRouter.Endpoints.Access do
  @moduledoc """
  Which endpoints count as clients, so that what they send is judged by who they are (`MavRouter.Forward.Gate`).

  The peers of `clients`, WebSockets and unix sockets do. For the endpoints of a **link** its `gcs` decides:

  | `gcs` | |
  |---|---|
  | `:auto` (default) | only endpoints with a loopback address, which this machine itself sends from |
  | `:allow` | everybody who reaches the link |
  | `:deny` | nobody, not even this machine |

  Nobody else on a link commands a vehicle.
  """

  alias Aerie.Base.Net.Address
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints.Owner

  @doc "Whether who sends from an endpoint counts as a client."
  @spec commands?(Endpoint.t(), Owner.t()) :: boolean
  def commands?(_endpoint, %Owner{side: :client}), do: true
  def commands?(_endpoint, %Owner{gcs: :allow}), do: true
  def commands?(_endpoint, %Owner{gcs: :deny}), do: false
  def commands?(endpoint, %Owner{gcs: :auto}), do: local?(endpoint)

  @doc "Whether only this machine can send from an endpoint: its address is loopback, or it is in this program."
  @spec local?(Endpoint.t()) :: boolean
  def local?(%Endpoint{kind: :link, text: text}), do: loopback?(text)

  def local?(%Endpoint{kind: :websocket, text: text}),
    do: text |> to_string() |> String.split("@") |> List.last() |> loopback?()

  def local?(%Endpoint{}), do: true

  @doc "Whether an address, as `ADDRESS:PORT` and with IPv6 in brackets, is one that only this machine can send from."
  @spec loopback?(String.t() | nil) :: boolean
  def loopback?(text) when is_binary(text) do
    with [_all, address] <- Regex.run(~r/\A(\[[^\]]+\]|[\d.]+):\d+\z/, text),
         {:ok, address} <- address |> String.trim("[") |> String.trim("]") |> parsed() do
      Address.loopback?(address)
    else
      _no_address -> false
    end
  end

  def loopback?(_none), do: false

  defp parsed(address), do: address |> String.to_charlist() |> :inet.parse_strict_address()
end
