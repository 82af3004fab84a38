defmodule Aerie.Api.Rest.View.SigningCapability do
  @moduledoc """
  What `GET /api/signing/capability` shows: who can sign, who does, and by which links a key can be given. Never a key (S9).
  A vehicle that another gateway hears is signed by that one, so nothing is known of its signing here.
  """

  import Bitwise

  alias Aerie.Fleet
  alias Aerie.Vehicle.Enrolment
  alias MavRouter.Signing
  alias Aerie.Base.Json.Object

  # MAV_PROTOCOL_CAPABILITY_MAVLINK2
  @mavlink2 8192

  @link [
    {:id, :text, nil, "name of the link"},
    {:network, :text, nil, "its network"},
    {:status, :text, nil, "its status"}
  ]
  @heard Object.fields(@link ++ [{:heard, :boolean, nil, "whether the vehicle is heard there"}])
  @gateway Object.fields([
             {:mavlink_version, :integer, nil, "the version that it speaks"},
             {:can_sign, :boolean, nil, "whether it can sign"},
             {:signs, :boolean, nil, "whether it has a key that is in use"},
             {:keys, :integer, nil, "how many keys it has"},
             {:not_stored, :text, nil, "why time stamps of signed links cannot be stored"},
             {:secure_links, {:list, {:object, Object.fields(@link)}}, nil,
              "links by which keys can be given"}
           ])
  @vehicle Object.fields([
             {:id, :text, nil, "the vehicle's id"},
             {:network, :text, nil, "its network"},
             {:system_id, :integer, nil, "its system id"},
             {:via, :text, nil, "the gateway that hears it; null: this one"},
             {:mavlink_version, :integer, nil, "the version of its heartbeats"},
             {:can_sign, :boolean, nil, "MAVLink 1 has no signatures; null: not known"},
             {:signing, {:object, Signing.fields()}, nil, "null without a key"},
             {:pending, :boolean, nil, "whether it was sent a key and has not proven it yet"},
             {:secure_links, {:list, {:object, @heard}}, nil,
              "links of its network by which it can be given a key"}
           ])
  @fields Object.fields([
            {:gateway, {:object, @gateway}, nil, "this gateway"},
            {:vehicles, {:list, {:object, @vehicle}}, nil, "all vehicles"}
          ])

  @doc "The fields of the object."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc "The object of a gateway."
  @spec of(term()) :: map()
  def of(gateway) do
    signing = Signing.list(gateway)
    vehicles = for vehicle <- Fleet.vehicles(gateway), do: vehicle(gateway, vehicle, signing.pending)
    Object.show(@fields, %{gateway: gateway(gateway, signing), vehicles: vehicles})
  end

  defp gateway(gateway, %{keys: keys, not_stored: not_stored}) do
    %{
      mavlink_version: 2,
      can_sign: true,
      signs: Enum.any?(keys, &(&1.error == nil and &1.policy != :off)),
      keys: length(keys),
      not_stored: not_stored,
      secure_links: Enum.sort_by(Enrolment.links(gateway), & &1.id)
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
      signing: if(here?, do: Signing.vehicle(gateway, key)),
      pending: here? and "#{network}/#{system}" in pending,
      secure_links: if(here?, do: Enum.sort_by(Enrolment.links(gateway, key), & &1.id), else: [])
    }
  end

  # A flight controller that can do MAVLink 2 may send version 1 until it hears version 2.
  defp can_sign(%{mavlink_version: 2}), do: true

  defp can_sign(%{capabilities: capabilities}) when is_integer(capabilities),
    do: (capabilities &&& @mavlink2) != 0

  defp can_sign(%{mavlink_version: 1}), do: false
  defp can_sign(_unknown), do: nil
end
