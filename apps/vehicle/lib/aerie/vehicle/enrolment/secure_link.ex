defmodule Aerie.Vehicle.Enrolment.SecureLink do
  @moduledoc """
  Chooses the link over which a key is sent to a vehicle (S8). Only a link that the operator marked secure is used, because
  anybody who hears the frame learns the key. Otherwise the error says what to do.
  """

  alias Aerie.Base.Error
  alias Aerie.Base.Store
  alias MavRouter.Link
  alias Aerie.Base.Names
  alias MavRouter.Router
  alias MavRouter.Signing

  @type key :: {network :: String.t(), system :: non_neg_integer}

  @doc "The key of a vehicle, from its name or its key."
  @spec key(Names.gateway(), Signing.vehicle()) :: {:ok, key} | {:error, Error.t()}
  def key(_gateway, {network, system} = key) when is_binary(network) and is_integer(system), do: {:ok, key}

  def key(gateway, id) when is_binary(id) do
    case Store.vehicle(gateway, id) do
      %{key: key} ->
        {:ok, key}

      nil ->
        Error.new(
          {:unknown, :vehicle, id},
          "#{known(gateway)}; name it by its network and system id, like {\"main\", 7}"
        )
    end
  end

  def key(_gateway, other),
    do:
      Error.new(
        {:invalid,
         "#{inspect(other, limit: 5)} is not a vehicle: expected its name, like \"VID-007\", or its network and system id, like {\"main\", 7}"}
      )

  defp known(gateway) do
    case gateway |> Store.vehicles() |> Enum.take(8) |> Enum.map_join(", ", & &1.id) do
      "" -> "none has been heard yet"
      names -> "known are #{names}"
    end
  end

  @doc "The links that are marked secure, each with its network and status; of one network unless that is nil."
  @spec all(Names.gateway(), String.t() | nil) :: [%{id: String.t(), network: String.t(), status: atom()}]
  def all(gateway, network \\ nil) do
    for %{spec: spec} = link <- Link.list(gateway),
        network in [nil, link.network],
        Signing.trust(spec) == :secure,
        do: Map.take(link, [:id, :network, :status])
  end

  @doc "Whether a vehicle is heard on a link, which then need not be named to give it a key."
  @spec reachable?(Names.gateway(), key, String.t()) :: boolean()
  def reachable?(gateway, key, id), do: Router.route(gateway, key, link: id) != nil

  @doc "The secure link to use, and to which of its peers; `id` is the caller's choice of a link, or nil."
  @spec secure(Names.gateway(), key, String.t() | nil) :: {:ok, String.t(), Link.to()} | {:error, Error.t()}
  def secure(gateway, {network, system} = key, nil) do
    links = for %{network: ^network, spec: spec} <- Link.list(gateway), do: {spec.id, Signing.trust(spec)}
    secure = for {id, :secure} <- links, route = Router.route(gateway, key, link: id), do: route

    case secure do
      [{link, peer} | _] ->
        {:ok, link, {:peer, peer}}

      [] ->
        heard = for {id, _trust} <- links, Router.route(gateway, key, link: id), do: id

        Error.new(
          {:invalid,
           "system #{system} of network #{network} is not heard on a link that is marked secure " <>
             "(#{if heard == [], do: "it is not heard at all", else: "only on " <> Enum.join(heard, ", ")})"},
          "connect it by USB or Ethernet and set secure: true for that link, or name the link (link: \"usb\")" <>
            named(for({id, :secure} <- links, do: id))
        )
    end
  end

  def secure(gateway, {network, system}, id) do
    case Link.get(gateway, id) do
      %{network: ^network, spec: spec} ->
        cond do
          Signing.trust(spec) != :secure ->
            Error.new(
              {:invalid,
               "link #{id} is not marked secure: anybody who hears it would learn the key. If it is a cable of its own, mark it with " <>
                 "secure: true, or ?secure=true in its connection string"}
            )

          route = Router.route(gateway, {network, system}, link: id) ->
            {:ok, id, {:peer, elem(route, 1)}}

          true ->
            {:ok, id, :all}
        end

      %{network: other} ->
        Error.new({:invalid, "link #{id} belongs to network #{other}, not to #{network}"})

      nil ->
        Error.new({:unknown, :link, id})
    end
  end

  defp named([]), do: ""
  defp named(links), do: "; secure are #{Enum.join(links, ", ")}"
end
