defmodule Aerie.Api.Rest.View.SigningCapability do
  @moduledoc """
  What `GET /api/signing/capability` shows: who can sign, who does, and by which links a key can be given. Never a key (S9).

  * `gateway` - its `mavlink_version`, whether it `can_sign` and `signs` (it has a key that is in use), how many `keys` it has,
    `not_stored` (why time stamps of signed links cannot be stored), and all `secure_links` with `id`, `network`, `status`
  * `vehicles` - each with `id`, `network`, `system_id`, `mavlink_version` (of its heartbeats), `can_sign` (MAVLink 1 has no
    signatures; null: not known), `signing` as in `GET /api/vehicles/ID/signing` (null without a key), `pending` (it was sent a key and has
    not proven it yet), `via` (the gateway that hears it, null: this one) and `secure_links` of its network, each with `heard`

  A vehicle that another gateway hears is signed by that one, so nothing is known of its signing here.
  """

  import Bitwise

  alias Aerie.Fleet
  alias Aerie.Vehicle.Enrolment
  alias MavRouter.Signing
  alias Aerie.Base.Json
  alias Aerie.Api.Rest.View

  # MAV_PROTOCOL_CAPABILITY_MAVLINK2
  @mavlink2 8192

  @doc "The object of a gateway."
  @spec of(term()) :: map()
  def of(gateway) do
    signing = Signing.list(gateway)
    vehicles = for vehicle <- Fleet.vehicles(gateway), do: vehicle(gateway, vehicle, signing.pending)
    %{gateway: gateway(gateway, signing), vehicles: vehicles}
  end

  defp gateway(gateway, %{keys: keys, not_stored: not_stored}) do
    %{
      mavlink_version: 2,
      can_sign: true,
      signs: Enum.any?(keys, &(&1.error == nil and &1.policy != :off)),
      keys: length(keys),
      not_stored: not_stored,
      secure_links: Json.plain(Enum.sort_by(Enrolment.links(gateway), & &1.id))
    }
  end

  defp vehicle(gateway, %{key: {network, system} = key} = vehicle, pending) do
    here? = vehicle.via == nil

    %{
      id: vehicle.id,
      network: network,
      system_id: system,
      via: vehicle.via,
      mavlink_version: vehicle.mavlink_version,
      can_sign: can_sign(vehicle),
      signing: if(here?, do: View.signed(Signing.vehicle(gateway, key))),
      pending: here? and "#{network}/#{system}" in pending,
      secure_links: if(here?, do: Json.plain(Enum.sort_by(Enrolment.links(gateway, key), & &1.id)), else: [])
    }
  end

  # A flight controller that can do MAVLink 2 may send version 1 until it hears version 2.
  defp can_sign(%{mavlink_version: 2}), do: true

  defp can_sign(%{capabilities: capabilities}) when is_integer(capabilities),
    do: (capabilities &&& @mavlink2) != 0

  defp can_sign(%{mavlink_version: 1}), do: false
  defp can_sign(_unknown), do: nil
end
