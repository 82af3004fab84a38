defmodule Aerie.Vehicle.Enrolment do
  @moduledoc """
  Gives a flight controller a signing key, or takes it away; runs in the process of the caller.

  SETUP_SIGNING is not acknowledged: it worked when frames with the new signature come (or unsigned ones, after the key
  was taken away). Until then it is sent again every two seconds. It is signed with the key in force, which a flight
  controller with that key requires, and one without a key ignores.

  So that nobody is locked out, a new key goes through two phases:

  1. **staged**: the key is on the disk (`MavRouter.Signing.KeyStore.KeyFiles`) before it is sent. The key in force
  stays in use in both
     directions. A signature that does not match it is tried with the staged key.
  2. **proven**: the first frame that is signed with the staged key puts it in force, whether or not a caller still
     waits, even an hour later or after a restart.

  If no such frame comes, both keys stay known, and the error says which one the vehicle uses. Call `enrol/3` again to
  send the staged key again, `discard/2` to forget it, and use `key: :previous` to go back to the former key.
  """

  alias Aerie.Base.Error
  alias MavRouter.Identity
  alias Aerie.Base.Secret
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Enrolment.SecureLink
  alias MavRouter.Link
  alias Aerie.Base.Names
  alias MavRouter.Signing
  alias MavRouter.Signing.{Audit, Key, KeyStore, Tables, Verifiers}
  alias MavCodec.Messages.SetupSigning

  @resend_ms 2_000
  @timeout_ms 10_000
  @options [:link, :key, component: 1, timeout_ms: @timeout_ms, by: "local"]

  @doc """
  Gives a flight controller its key by SETUP_SIGNING, and waits until it signs with it.

  This needs a link that is marked secure in the configuration or in its connection string (USB, Ethernet), because the
  key is sent unencrypted; other links are refused with the reason (S8). Options:

    * `:link` - the secure link to use; required if the vehicle is not heard there (its frames may be refused)
    * `:key` - another key than the one in force: `{:file, path}`, `{:env, name}`, `:generate` (random), or `:previous`
      (the former key). It is stored in `signing.dir/keys` before it is sent, and is in force as soon as the vehicle
      proves that it has it (`Aerie.Vehicle.Enrolment`). The result has a generated key as an `Aerie.Base.Secret`.
    * `:component` - of the autopilot, default 1
    * `:timeout_ms` - default 10,000
    * `:by` - who asks, for the audit event; default `"local"`
  """
  @spec enrol(Names.gateway(), Signing.vehicle(), keyword) ::
          {:ok, %{link: String.t(), key: Secret.t() | nil}} | {:error, Error.t()}
  def enrol(gateway, vehicle, options \\ []) do
    with {:ok, given} <- given(options[:key]),
         {:ok, job} <- job(gateway, vehicle, options) do
      exclusive(job, fn job ->
        with {:ok, scope} <- stage(job, given),
             :ok <- run(job, Secret.reveal(scope.secret), {:verified, scope.generation}),
             :ok <- KeyStore.settle(gateway) do
          {:ok, %{link: job.link, key: if(options[:key] == :generate, do: scope.secret)}}
        end
        |> Audit.record(job, :enrolled)
      end)
    end
  end

  @doc """
  Takes the key away from a flight controller (SETUP_SIGNING with zeros), and waits until it sends unsigned frames.
  Needs a secure link, like `enrol/3`; options `:link`, `:component`, `:timeout_ms`, `:by`. A key that `enrol/3` gave is
  retired (kept as the previous one); the configuration of the vehicle does not change.
  """
  @spec revoke(Names.gateway(), Signing.vehicle(), keyword) ::
          {:ok, %{link: String.t()}} | {:error, Error.t()}
  def revoke(gateway, vehicle, options \\ []) do
    with {:ok, job} <- job(gateway, vehicle, Keyword.delete(options, :key)) do
      exclusive(job, fn job ->
        with :ok <- run(job, <<0::256>>, :unsigned),
             :ok <- KeyStore.retire(gateway, job.key) do
          {:ok, %{link: job.link}}
        end
        |> Audit.record(job, :revoked)
      end)
    end
  end

  @doc "Forgets a staged key. Only if it is certain that the vehicle does not have it: otherwise it is locked out."
  @spec discard(Names.gateway(), Signing.vehicle()) :: :ok | {:error, Error.t()}
  def discard(gateway, vehicle) do
    with {:ok, key} <- SecureLink.key(gateway, vehicle), do: KeyStore.discard(gateway, key)
  end

  @doc """
  The links that are marked secure, by which keys can be given; of `key`'s network, with whether that vehicle is `heard`
  there, if one is given.
  """
  @spec links(Names.gateway(), SecureLink.key() | nil) :: [map]
  def links(gateway, key \\ nil)
  def links(gateway, nil), do: SecureLink.all(gateway)

  def links(gateway, {network, _system} = key) do
    for %{id: id} = link <- SecureLink.all(gateway, network),
        do: Map.put(link, :heard, SecureLink.reachable?(gateway, key, id))
  end

  defp job(gateway, vehicle, options) do
    options = Keyword.validate!(options, @options)

    with {:ok, tables} <- tables(gateway),
         {:ok, key} <- SecureLink.key(gateway, vehicle),
         :ok <- usable(Tables.scope(tables, key), key, options[:key]),
         :ok <- disarmed(gateway, key),
         {:ok, link, to} <- SecureLink.secure(gateway, key, options[:link]) do
      {:ok,
       %{
         gateway: gateway,
         tables: tables,
         key: key,
         scope: Tables.scope(tables, key),
         link: link,
         to: to,
         component: options[:component],
         timeout_ms: options[:timeout_ms],
         by: options[:by],
         reference: nil
       }}
    end
  end

  defp tables(gateway) do
    case Tables.of(gateway) do
      nil -> Error.new({:unavailable, "the gateway #{inspect(gateway)} is not running"})
      tables -> {:ok, tables}
    end
  end

  # ArduPilot accepts no key while armed, and nothing that might lock a vehicle out should happen in flight.
  defp disarmed(gateway, {network, system} = key) do
    case Store.vehicle(gateway, key) do
      %{groups: %{mode: %{data: %{armed: true}}}} ->
        Error.new(
          {:conflict,
           "system #{system} of network #{network} is armed; keys are changed on the ground, disarmed"}
        )

      _disarmed_or_unknown ->
        :ok
    end
  end

  # Without a key in force, the caller has to give one.
  defp usable(nil, {network, system}, nil) do
    Error.new(
      {:invalid, "no signing key is configured for system #{system} of network #{network}"},
      "name one in signing.keys, or use key: :generate"
    )
  end

  defp usable(%{policy: :off}, {network, system}, _new),
    do: Error.new({:invalid, "signing is off for system #{system} of network #{network} (signing.keys)"})

  defp usable(%{secret: nil, error: error}, _key, nil), do: Error.new({:unavailable, error})
  defp usable(_scope, _key, _new), do: :ok

  defp given(nil), do: {:ok, nil}
  defp given(key) when key in [:generate, :previous], do: {:ok, key}

  defp given({kind, name} = source) when kind in [:file, :env] and is_binary(name) do
    with {:error, text} <- Key.read(source), do: Error.new({:invalid, text})
  end

  defp given(_other) do
    Error.new(
      {:invalid,
       ~s(key is {:file, "PATH"}, {:env, "NAME"}, :generate or :previous; the key itself is not accepted)}
    )
  end

  # The key in force needs no staging.
  defp stage(job, nil), do: {:ok, job.scope}

  defp stage(job, given) do
    if given not in [:generate, :previous] and job.scope != nil and Key.same?(given, job.scope.secret),
      do: {:ok, job.scope},
      else: KeyStore.stage(job.gateway, job.key, given)
  end

  defp exclusive(job, fun) do
    reference = :erlang.alias()
    waiter = {job.key, reference, reference}

    try do
      if :ets.insert_new(job.tables.waiters, waiter),
        do: fun.(%{job | reference: reference}),
        else: Error.new({:conflict, "another enrolment of this vehicle is in progress"})
    after
      :ets.delete_object(job.tables.waiters, waiter)
      :erlang.unalias(reference)
      flush(reference)
    end
  end

  defp flush(reference) do
    receive do
      {^reference, _what, _link, _component} -> flush(reference)
    after
      0 -> :ok
    end
  end

  defp run(job, secret, expected) do
    bytes = setup(job, secret)

    with :ok <- send_setup(job, bytes),
         do: await(job, bytes, expected, now() + job.timeout_ms, now() + @resend_ms, :nothing)
  end

  # `seen`: what came instead.
  defp await(
         %{reference: reference, link: link, component: component} = job,
         bytes,
         expected,
         deadline,
         resend_at,
         seen
       ) do
    receive do
      {^reference, ^expected, ^link, ^component} ->
        :ok

      {^reference, :unsigned, ^link, ^component} ->
        await(job, bytes, expected, deadline, resend_at, :unsigned)

      {^reference, {:verified, _}, ^link, ^component} ->
        await(job, bytes, expected, deadline, resend_at, :former)

      {^reference, _what, _link, _component} ->
        await(job, bytes, expected, deadline, resend_at, seen)
    after
      max(min(resend_at, deadline) - now(), 0) ->
        if now() >= deadline do
          Error.new({:unavailable, failure(expected, seen, job)})
        else
          with :ok <- send_setup(job, bytes),
               do: await(job, bytes, expected, deadline, now() + @resend_ms, seen)
        end
    end
  end

  defp failure({:verified, _generation}, seen, job) do
    found =
      case seen do
        :former -> "it still signs with its former key"
        :unsigned -> "it still sends unsigned frames"
        :nothing -> "nothing from component #{job.component} shows which key it uses"
      end

    "no frame signed with the new key came on link #{job.link} within #{job.timeout_ms} ms: #{found}. Both keys stay known, " <>
      "and the one with which the vehicle signs is used; enrol again, or discard the new key"
  end

  defp failure(:unsigned, _seen, job),
    do:
      "no unsigned frame came on link #{job.link} within #{job.timeout_ms} ms; the vehicle may still have its key, which stays known"

  # A secret until it is written: mailboxes and crash reports show messages (S9).
  defp setup(job, secret) do
    {_network, system} = job.key
    {own_system, own_component} = Tables.setting(job.tables, :own, Identity.default_ids())

    # All zeros take the key away, the timestamp included.
    timestamp = if secret == <<0::256>>, do: 0, else: Verifiers.timestamp(job.tables, job.link, job.scope)

    Secret.new(
      MavCodec.encode(
        %SetupSigning{
          target_system: system,
          target_component: job.component,
          secret_key: secret,
          initial_timestamp: timestamp
        },
        system: own_system,
        component: own_component,
        sysid32: system > 255
      )
    )
  end

  # Signed with the key that was in force when the enrolment began, even if that changes before it is written.
  defp send_setup(job, bytes) do
    with {:error, reason} <- Link.send_bytes(job.gateway, job.link, {:secret, job.scope, bytes}, job.to),
         do: Error.new({:unavailable, "cannot write to link #{job.link}: #{reason}"})
  end

  defp now, do: System.monotonic_time(:millisecond)
end
