defmodule Aerie.Fleet.Shadow.Keys do
  @moduledoc """
  The keys by which desired documents are sealed: one for each vehicle, so that the key of one does not open another one's.
  Pure.

  The key of a vehicle is derived from a common one (`shadow.key`), which stays at the hub; a companion has that of its own vehicle
  (`shadow.vehicle_key`). Vehicles that a companion hears besides have keys of its own making, from the one in `shadow.dir`.
  """

  alias Aerie.Fleet.Bridge.Hub.VehicleKey
  alias Aerie.Base.Secret

  @enforce_keys [:common]
  defstruct [:common, :former, own: %{}]

  @typedoc """
    * `:common` - from which keys are derived
    * `:own` - keys that were given for vehicles
    * `:former` - the common key of before, with which documents were sealed for all vehicles alike; nil for none
  """
  @type t :: %__MODULE__{common: Secret.t(), former: Secret.t() | nil, own: %{String.t() => Secret.t()}}

  @doc "The key of a vehicle in an environment."
  @spec of(t(), environment :: String.t(), vehicle :: String.t()) :: Secret.t()
  def of(%__MODULE__{own: own, common: common}, environment, vehicle) do
    case own do
      %{^vehicle => key} -> key
      _derived -> common |> Secret.reveal() |> derive(environment, vehicle) |> Secret.new()
    end
  end

  @doc "The keys with which earlier versions sealed the documents of all vehicles."
  @spec former(t()) :: [Secret.t()]
  def former(%__MODULE__{common: common, former: former}), do: [common | List.wrap(former)]

  @doc "The key of a vehicle as text, from the common one."
  @spec derive(common :: String.t(), environment :: String.t(), vehicle :: String.t()) :: String.t()
  defdelegate derive(common, environment, vehicle), to: VehicleKey
end
