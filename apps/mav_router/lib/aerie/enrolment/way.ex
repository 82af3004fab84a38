defmodule Aerie.Enrolment.Way do
  @moduledoc """
  By which link a key may go to a vehicle (S8): one that the operator marked secure, because whoever hears it learns the
  key. Everything else is refused, with what to do about it.
  """

  alias Aerie.Store
  alias Aerie.Link
  alias Aerie.Names
  alias Aerie.Router
  alias Aerie.Signing

  @type key :: {network :: String.t(), system :: non_neg_integer}

  @doc "The key of a vehicle that is named by its public name or by its key."
  @spec key(Names.gateway(), Signing.vehicle()) :: {:ok, key} | {:error, String.t()}
  def key(_gateway, {network, system} = key) when is_binary(network) and is_integer(system), do: {:ok, key}

  def key(gateway, id) when is_binary(id) do
    case Store.vehicle(gateway, id) do
      %{key: key} ->
        {:ok, key}

      nil ->
        {:error,
         "no vehicle #{id} is known (#{known(gateway)}); name it by its network and system id, as {\"main\", 7}"}
    end
  end

  def key(_gateway, other),
    do:
      {:error,
       "#{inspect(other, limit: 5)} is no vehicle: its name, as \"VID-007\", or its network and system id, as {\"main\", 7}"}

  defp known(gateway) do
    case gateway |> Store.vehicles() |> Enum.take(8) |> Enum.map_join(", ", & &1.id) do
      "" -> "none was heard yet"
      names -> "known are #{names}"
    end
  end

  @doc "The secure link to take, and to which of its peers; `id` is the caller's choice of a link, or nil."
  @spec secure(Names.gateway(), key, String.t() | nil) :: {:ok, String.t(), Link.to()} | {:error, String.t()}
  def secure(gateway, {network, system} = key, nil) do
    ways = for %{network: ^network, spec: spec} <- Link.list(gateway), do: {spec.id, Signing.trust(spec)}
    secure = for {id, :secure} <- ways, way = Router.way(gateway, key, link: id), do: way

    case secure do
      [{link, peer} | _] ->
        {:ok, link, {:peer, peer}}

      [] ->
        heard = for {id, _} <- ways, Router.way(gateway, key, link: id), do: id

        {:error,
         "system #{system} of network #{network} is not heard by a link that is marked secure " <>
           "(#{if heard == [], do: "it is not heard at all", else: "only by " <> Enum.join(heard, ", ")}); " <>
           "connect it by USB or Ethernet and set secure: true for that link, or name the link (link: \"usb\")" <>
           named(for({id, :secure} <- ways, do: id))}
    end
  end

  def secure(gateway, {network, system}, id) do
    case Link.get(gateway, id) do
      %{network: ^network, spec: spec} ->
        cond do
          Signing.trust(spec) != :secure ->
            {:error,
             "link #{id} is not marked secure: anybody who hears it would learn the key. If it is a cable of its own, say so: " <>
               "secure: true, or ?secure=true in its connection string"}

          way = Router.way(gateway, {network, system}, link: id) ->
            {:ok, id, {:peer, elem(way, 1)}}

          true ->
            {:ok, id, :all}
        end

      %{network: other} ->
        {:error, "link #{id} belongs to network #{other}, not to #{network}"}

      nil ->
        {:error, "there is no link #{id}"}
    end
  end

  defp named([]), do: ""
  defp named(links), do: "; secure are #{Enum.join(links, ", ")}"
end
