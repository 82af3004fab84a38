defmodule Aerie.Fleet.Bridge.Hub.VehicleKey do
  @moduledoc "The key of one vehicle, derived from one that the hub keeps. Pure."

  @context "aerie-shadow-vehicle-1"

  @doc "The key of a vehicle in an environment, as text. It says nothing of the common key or of another vehicle's."
  @spec derive(common :: String.t(), environment :: String.t(), vehicle :: String.t()) :: String.t()
  def derive(common, environment, vehicle) do
    # No name has a zero.
    text = Enum.join([@context, environment, vehicle], <<0>>)
    :hmac |> :crypto.mac(:sha256, common, text) |> Base.encode16(case: :lower)
  end
end
