defmodule Aerie.Enrolment do
  @moduledoc """
  Gives a flight controller a key, or takes it away; runs in the process that asks.

  There is no answer to SETUP_SIGNING: that it worked is seen when frames with a right signature come (or, after a key was
  taken away, unsigned ones). It is sent again every two seconds until then. It is signed with the key in force, which a
  flight controller that has that key asks for, and another one overlooks.

  So that nobody is locked out, a new key goes through two phases:

  1. **staged**: written to the disk (`Aerie.Signing.KeyFiles`) before it is sent. The key in force stays: what the vehicle
     signs with it is taken in as before, and we sign with it. A signature that does not fit is tried with the staged key.
  2. **proven**: the first frame that is signed with the staged key puts it in force, whoever is waiting for that or not,
     an hour later or after a restart.

  If that does not come in time, both keys stay known, and the error says which one the vehicle uses. `enrol/3` again sends
  the staged one again; `discard/2` forgets it; `key: :previous` goes back to the one before.
  """

  alias Aerie.Identity
  alias Aerie.Secret
  alias Aerie.Store
  alias Aerie.Enrolment.Way
  alias Aerie.Link
  alias Aerie.Names
  alias Aerie.Signing
  alias Aerie.Signing.{Audit, Guards, Key, Tables, Vault}
  alias MavCodec.Messages.SetupSigning

  @again_ms 2_000
  @timeout_ms 10_000
  @options [:link, :key, component: 1, timeout_ms: @timeout_ms, by: "local"]

  @doc """
  Gives a flight controller its key by SETUP_SIGNING, and waits until it signs with it.

  Only by a link that is marked secure in the configuration or its connection string (USB, Ethernet), because the key goes
  over it as it is; anything else is refused with the reason (S8). Options:

    * `:link` - the secure link to take; needed when the vehicle is not heard there (its frames may be refused)
    * `:key` - another key than the one in force: `{:file, path}`, `{:env, name}`, `:generate` (random), or `:previous` (go
      back to the one before). It is kept in `signing.dir/keys` from before it is sent, and is in force as soon as the
      vehicle proves to have it (`Aerie.Enrolment`). A generated one is in the result, as a `Aerie.Secret`.
    * `:component` - of the autopilot, default 1
    * `:timeout_ms` - default 10,000
    * `:by` - who asks, for the audit event; default `"local"`
  """
  @spec enrol(Names.gateway(), Signing.vehicle(), keyword) ::
          {:ok, %{link: String.t(), key: Secret.t() | nil}} | {:error, String.t()}
  def enrol(gateway, vehicle, options \\ []) do
    with {:ok, given} <- given(options[:key]),
         {:ok, job} <- job(gateway, vehicle, options) do
      exclusive(job, fn job ->
        with {:ok, scope} <- stage(job, given),
             :ok <- run(job, Secret.reveal(scope.secret), {:verified, scope.generation}),
             :ok <- Vault.settle(gateway) do
          {:ok, %{link: job.link, key: if(options[:key] == :generate, do: scope.secret)}}
        end
        |> Audit.told(job, :enrolled)
      end)
    end
  end

  @doc """
  Takes the key from a flight controller (SETUP_SIGNING with zeros), and waits until it sends unsigned frames. By a secure
  link only, like `enrol/3`; options `:link`, `:component`, `:timeout_ms`, `:by`. A key that it was given by `enrol/3` is
  retired (kept as the previous one); what the configuration says of the vehicle stays.
  """
  @spec revoke(Names.gateway(), Signing.vehicle(), keyword) ::
          {:ok, %{link: String.t()}} | {:error, String.t()}
  def revoke(gateway, vehicle, options \\ []) do
    with {:ok, job} <- job(gateway, vehicle, Keyword.delete(options, :key)) do
      exclusive(job, fn job ->
        with :ok <- run(job, <<0::256>>, :unsigned),
             :ok <- Vault.retire(gateway, job.key) do
          {:ok, %{link: job.link}}
        end
        |> Audit.told(job, :revoked)
      end)
    end
  end

  @doc "Forgets a key that was sent to a vehicle and never proven: only when it is certain that the vehicle has not got it."
  @spec discard(Names.gateway(), Signing.vehicle()) :: :ok | {:error, String.t()}
  def discard(gateway, vehicle) do
    with {:ok, key} <- Way.key(gateway, vehicle), do: Vault.discard(gateway, key)
  end

  defp job(gateway, vehicle, options) do
    options = Keyword.validate!(options, @options)

    with {:ok, tables} <- tables(gateway),
         {:ok, key} <- Way.key(gateway, vehicle),
         :ok <- usable(Tables.scope(tables, key), key, options[:key]),
         :ok <- disarmed(gateway, key),
         {:ok, link, to} <- Way.secure(gateway, key, options[:link]) do
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
      nil -> {:error, "the gateway #{inspect(gateway)} is not running"}
      tables -> {:ok, tables}
    end
  end

  # ArduPilot takes none while armed; and nothing that may lock a vehicle out is for the air.
  defp disarmed(gateway, {network, system} = key) do
    case Store.vehicle(gateway, key) do
      %{groups: %{mode: %{data: %{armed: true}}}} ->
        {:error, "system #{system} of network #{network} is armed; keys are changed on the ground, disarmed"}

      _disarmed_or_unknown ->
        :ok
    end
  end

  # Without a key in force one must be given.
  defp usable(nil, {network, system}, nil) do
    {:error,
     "no signing key is configured for system #{system} of network #{network}: name one in signing.keys, or have one " <>
       "made with key: :generate"}
  end

  defp usable(%{policy: :off}, {network, system}, _new),
    do: {:error, "signing is off for system #{system} of network #{network} (signing.keys)"}

  defp usable(%{secret: nil, error: error}, _key, nil), do: {:error, error}
  defp usable(_scope, _key, _new), do: :ok

  defp given(nil), do: {:ok, nil}
  defp given(key) when key in [:generate, :previous], do: {:ok, key}
  defp given({kind, name} = source) when kind in [:file, :env] and is_binary(name), do: Key.read(source)

  defp given(_other) do
    {:error, ~s(key is {:file, "PATH"}, {:env, "NAME"}, :generate or :previous; a key itself is never given)}
  end

  # A key that is in force already needs no second phase.
  defp stage(job, nil), do: {:ok, job.scope}

  defp stage(job, given) do
    if given not in [:generate, :previous] and job.scope != nil and Key.same?(given, job.scope.secret),
      do: {:ok, job.scope},
      else: Vault.stage(job.gateway, job.key, given)
  end

  defp exclusive(job, fun) do
    reference = :erlang.alias()
    waiter = {job.key, reference, reference}

    try do
      if :ets.insert_new(job.tables.waiters, waiter),
        do: fun.(%{job | reference: reference}),
        else: {:error, "somebody is just giving that vehicle a key"}
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
         do: await(job, bytes, expected, now() + job.timeout_ms, now() + @again_ms, :nothing)
  end

  # `seen`: what came instead.
  defp await(
         %{reference: reference, link: link, component: component} = job,
         bytes,
         expected,
         deadline,
         again,
         seen
       ) do
    receive do
      {^reference, ^expected, ^link, ^component} -> :ok
      {^reference, :unsigned, ^link, ^component} -> await(job, bytes, expected, deadline, again, :unsigned)
      {^reference, {:verified, _}, ^link, ^component} -> await(job, bytes, expected, deadline, again, :former)
      {^reference, _what, _link, _component} -> await(job, bytes, expected, deadline, again, seen)
    after
      max(min(again, deadline) - now(), 0) ->
        if now() >= deadline do
          {:error, failure(expected, seen, job)}
        else
          with :ok <- send_setup(job, bytes),
               do: await(job, bytes, expected, deadline, now() + @again_ms, seen)
        end
    end
  end

  defp failure({:verified, _generation}, seen, job) do
    found =
      case seen do
        :former -> "it goes on signing with the key that it had"
        :unsigned -> "it goes on sending without a signature"
        :nothing -> "nothing that tells was heard of component #{job.component}"
      end

    "no frame signed with that key came by #{job.link} within #{job.timeout_ms} ms: #{found}. Both keys stay known, and " <>
      "the one that the vehicle proves to have is used; enrol again, or discard the new one"
  end

  defp failure(:unsigned, _seen, job),
    do:
      "no unsigned frame came by #{job.link} within #{job.timeout_ms} ms; the vehicle may still have its key, which stays known"

  # Kept as a secret on its way: mailboxes and reports of crashes show messages (S9).
  defp setup(job, secret) do
    {_network, system} = job.key
    {own_system, own_component} = Tables.setting(job.tables, :own, Identity.default_ids())

    # Taking the key away is asked for with zeros throughout.
    timestamp = if secret == <<0::256>>, do: 0, else: Guards.timestamp(job.tables, job.link, job.scope)

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

  # Signed with the key that was in force when this began, whatever is by the time it goes out.
  defp send_setup(job, bytes) do
    with {:error, reason} <- Link.send_bytes(job.gateway, job.link, {:secret, job.scope, bytes}, job.to),
         do: {:error, "link #{job.link} cannot be written to: #{reason}"}
  end

  defp now, do: System.monotonic_time(:millisecond)
end
