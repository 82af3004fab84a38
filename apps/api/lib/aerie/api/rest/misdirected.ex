defmodule Aerie.Api.Rest.Misdirected do
  @moduledoc """
  Refuses what this gateway cannot say of a vehicle that only another gateway hears: its recordings and its signing. What goes by `Aerie.Control.Transfers` is refused there, by the rule `elsewhere`.
  """

  alias Aerie.Base.Names
  alias Aerie.Fleet
  alias Aerie.Access.HTTP.Error

  @here [:save, :record_vehicle, :vehicle_signing, :sign_vehicle]

  @doc "Whether the request may be answered here, by what it changes or asks for."
  @spec check(term(), Names.gateway(), vehicle :: String.t() | nil) :: :ok | {:error, Error.t()}
  def check(action, gateway, id) when action in @here do
    case Fleet.vehicle(gateway, id) do
      %{via: via} when via != nil -> {:error, Error.misdirected(via)}
      _heard_here_or_nowhere -> :ok
    end
  end

  def check(_action, _gateway, _id), do: :ok
end
