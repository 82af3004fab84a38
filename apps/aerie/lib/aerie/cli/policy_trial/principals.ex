defmodule Aerie.CLI.PolicyTrial.Principals do
  @moduledoc """
  Whose commands those of a recording are (pure). A recording has MAVLink ids and no endpoint: by default a ground station is judged as a client
  on this machine that `policy.clients` does not name, and who had the gateway command as an operator. `--as` chooses another principal for all
  of them. Names of the ledger are those of `policy.sources`, of keys of `api.keys_file`, and of the gateway's own parts.
  """

  alias Aerie.Access
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Roles.Sources
  alias Aerie.Fleet.Replay.PolicyTrial

  @type key :: Access.Keys.key()

  @doc "The function for `t:Aerie.Fleet.Replay.PolicyTrial.sender/0`; `as` is the word of `--as`, nil for none. `now` is for keys that expire."
  @spec as(String.t() | nil, Policy.t(), [key()], now :: integer()) ::
          {:ok, (PolicyTrial.sender() -> Roles.source())} | {:error, String.t()}
  def as(nil, policy, _keys, _now) do
    {:ok,
     fn
       {:station, ids} -> client(policy, ids, nil)
       {:source, name} -> Roles.principal(:key, name, :operator)
     end}
  end

  def as(word, policy, keys, now) do
    case Roles.parse(word) do
      {:ok, role} -> {:ok, fn {_kind, name} -> Roles.principal(:client, name, role) end}
      :error -> one(word, policy, keys, now)
    end
  end

  defp one(word, policy, keys, now) do
    listed? = Enum.any?(policy.clients, &(&1.id == word))

    case {listed?, named(word, policy, keys, now)} do
      {true, _source} -> {:ok, fn {_kind, name} -> client(policy, word, name) end}
      {false, nil} -> {:error, unknown(word, policy, keys)}
      {false, source} -> {:ok, fn _sender -> source end}
    end
  end

  # Two programs of one client are two in charge.
  defp client(policy, id, program) do
    Policy.principal(policy, %{
      owner: id,
      text: program,
      principal: nil,
      commands: true,
      local: true,
      side: :client,
      auto: false
    })
  end

  @doc "The principal of a name of the ledger at a time; nil if its role is not known."
  @spec named(String.t(), Policy.t(), [key()], at :: integer()) :: Roles.source() | nil
  def named(name, policy, keys, at) do
    case Sources.named(policy, name, at) do
      {:ok, source} ->
        source

      {:deny, :signature, _unlisted_or_expired} ->
        key(Enum.find(keys, &(&1.name == name)), at) || own(name, policy)
    end
  end

  defp key(nil, _at), do: nil
  defp key(%{until: until}, at) when until != nil and at >= until, do: nil
  defp key(key, _at), do: key |> Access.Principals.of() |> Access.Principals.commanding()

  defp own(name, _policy) when name in ["elixir", "bin/aerie"], do: Roles.principal(:gateway, name, :admin)
  defp own("shadow", _policy), do: Roles.principal(:gateway, "shadow", :operator)
  defp own("unsigned", %{unsigned: role}) when role != nil, do: Roles.principal(:stranger, "unsigned", role)
  defp own(_name, _policy), do: nil

  defp unknown(word, policy, keys) do
    names =
      for(%{id: id} when id != nil <- policy.clients, do: id) ++ Enum.map(policy.sources ++ keys, & &1.name)

    "--as: #{word} is not known; expected #{Enum.join(Enum.map(Roles.all(), &Atom.to_string/1) ++ names, ", ")}"
  end
end
