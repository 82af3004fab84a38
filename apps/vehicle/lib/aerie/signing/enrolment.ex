defmodule Aerie.Signing.Enrolment do
  @moduledoc """
  Gives a flight controller a key, or takes it away; runs in the process that asks.

  There is no answer to SETUP_SIGNING: that it worked is seen when frames with a right signature come (or, after a key was
  taken away, unsigned ones). It is sent again every two seconds until then. It is signed with the key in force, which a
  flight controller that has that key asks for, and another one overlooks.

  A new key is in force from the moment at which it was sent. If it is not seen to work in time, the old one is again.
  """

  alias Aerie.Config.Secret
  alias Aerie.Fleet.Store
  alias Aerie.Link
  alias Aerie.Names
  alias Aerie.Router
  alias Aerie.Signing
  alias Aerie.Signing.{Guards, Key, Scope, Tables, Vault}
  alias MavCodec.Messages.SetupSigning

  @again_ms 2_000
  @timeout_ms 10_000

  @doc "See `Aerie.Signing.enrol/3`."
  @spec enrol(Names.gateway(), Signing.vehicle(), keyword) :: {:ok, map} | {:error, String.t()}
  def enrol(gateway, vehicle, options) do
    with {:ok, job} <- job(gateway, vehicle, options),
         {:ok, new} <- new_key(job.scope, options[:key]) do
      scope =
        if new, do: Scope.renewed(%{job.scope | id: job.key, secret: new, error: nil, source: "enrolment"})

      secret = new || job.scope.secret

      case run(job, Secret.reveal(secret), scope, :verified) do
        :ok ->
          told(job, :enrolled)
          {:ok, %{link: job.link, key: if(options[:key] == :generate, do: new)}}

        {:error, reason} ->
          {:error, reason}
      end
    end
  end

  @doc "See `Aerie.Signing.revoke/3`."
  @spec revoke(Names.gateway(), Signing.vehicle(), keyword) :: {:ok, map} | {:error, String.t()}
  def revoke(gateway, vehicle, options) do
    with {:ok, job} <- job(gateway, vehicle, options),
         :ok <- run(job, <<0::256>>, nil, :unsigned) do
      told(job, :revoked)
      {:ok, %{link: job.link}}
    end
  end

  defp job(gateway, vehicle, options) do
    options = Keyword.validate!(options, [:link, :key, component: 1, timeout_ms: @timeout_ms])

    with {:ok, tables} <- tables(gateway),
         {:ok, key} <- key(gateway, vehicle),
         {:ok, scope} <- scope(tables, key),
         {:ok, link, to} <- secure_way(gateway, key, options[:link]) do
      {:ok,
       %{
         gateway: gateway,
         tables: tables,
         key: key,
         scope: scope,
         link: link,
         to: to,
         component: options[:component],
         timeout_ms: options[:timeout_ms]
       }}
    end
  end

  defp tables(gateway) do
    case Tables.active(gateway) do
      nil -> {:error, "no signing key is configured (signing.keys)"}
      tables -> {:ok, tables}
    end
  end

  defp key(_gateway, {network, system} = key) when is_binary(network) and is_integer(system), do: {:ok, key}

  defp key(gateway, id) when is_binary(id) do
    case Store.vehicle(gateway, id) do
      %{key: key} ->
        {:ok, key}

      nil ->
        {:error, "no vehicle #{id} is known; name it by its network and system id if it was not heard yet"}
    end
  end

  defp scope(tables, {network, system} = key) do
    case Tables.scope(tables, key) do
      nil -> {:error, "no signing key is configured for system #{system} of network #{network}"}
      %{policy: :off} -> {:error, "signing is off for system #{system} of network #{network} (signing.keys)"}
      %{secret: nil, error: error} -> {:error, error}
      scope -> {:ok, scope}
    end
  end

  # S8: the key goes over the link for all to see who can.
  defp secure_way(gateway, {network, system} = key, nil) do
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
           "connect it by USB or Ethernet and set secure: true for that link"}
    end
  end

  defp secure_way(gateway, {network, system}, id) do
    case Link.get(gateway, id) do
      %{network: ^network, spec: spec} ->
        cond do
          Signing.trust(spec) != :secure ->
            {:error, "link #{id} is not marked secure: anybody who hears it would learn the key"}

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

  defp new_key(_scope, nil), do: {:ok, nil}
  defp new_key(_scope, :generate), do: {:ok, Key.generate()}
  defp new_key(_scope, source), do: Key.read(source)

  # The scope in force is put back unless what was expected is seen.
  defp run(job, secret, scope, expected) do
    reference = :erlang.alias()
    waiter = {job.key, reference, reference}
    bytes = setup(job, secret)
    former = :ets.lookup_element(job.tables.scopes, job.key, 2, nil)
    deadline = now() + job.timeout_ms

    try do
      if :ets.insert_new(job.tables.waiters, waiter) do
        with :ok <- send_setup(job, bytes) do
          if scope, do: Vault.adopt(job.gateway, scope)
          result = await(job, bytes, reference, expected, deadline, now() + @again_ms)
          if result != :ok and scope, do: restore(job, former)
          result
        end
      else
        {:error, "somebody is just giving that vehicle a key"}
      end
    after
      :ets.delete_object(job.tables.waiters, waiter)
      :erlang.unalias(reference)
      flush(reference)
    end
  end

  defp flush(reference) do
    receive do
      {^reference, _what, _link} -> flush(reference)
    after
      0 -> :ok
    end
  end

  defp restore(job, nil), do: Vault.drop(job.gateway, job.key)
  defp restore(job, former), do: Vault.adopt(job.gateway, Scope.renewed(former))

  defp await(job, bytes, reference, expected, deadline, again) do
    link = job.link

    receive do
      {^reference, ^expected, ^link} -> :ok
      {^reference, _other, _link} -> await(job, bytes, reference, expected, deadline, again)
    after
      max(min(again, deadline) - now(), 0) ->
        if now() >= deadline do
          {:error, failure(expected, job)}
        else
          with :ok <- send_setup(job, bytes),
               do: await(job, bytes, reference, expected, deadline, now() + @again_ms)
        end
    end
  end

  defp failure(:verified, job),
    do:
      "no frame signed with that key came by #{job.link} within #{job.timeout_ms} ms; the key may be in the vehicle all the same"

  defp failure(:unsigned, job),
    do:
      "no unsigned frame came by #{job.link} within #{job.timeout_ms} ms; the vehicle may still have its key"

  defp setup(job, secret) do
    {_network, system} = job.key
    {own_system, own_component} = Tables.setting(job.tables, :own, {245, 191})

    # Taking the key away is asked for with zeros throughout.
    timestamp =
      if secret == <<0::256>>,
        do: 0,
        else: Guards.timestamp(job.tables, job.link, job.scope)

    MavCodec.encode(
      %SetupSigning{
        target_system: system,
        target_component: job.component,
        secret_key: secret,
        initial_timestamp: timestamp
      },
      system: own_system,
      component: own_component
    )
  end

  # Signed with the key that was in force when this began, whatever is by the time it goes out.
  defp send_setup(job, bytes) do
    with {:error, reason} <- Link.send_bytes(job.gateway, job.link, {:sign, job.scope, bytes}, job.to),
         do: {:error, "link #{job.link} cannot be written to: #{reason}"}
  end

  defp told(%{key: {network, system}} = job, what) do
    metadata = %{gateway: job.gateway, network: network, system: system, link: job.link}
    :telemetry.execute([:aerie, :signing, what], %{count: 1}, metadata)
  end

  defp now, do: System.monotonic_time(:millisecond)
end
