defmodule Aerie.Signing.Supervisor do
  @moduledoc """
  Owns the tables of signing (`Aerie.Signing.Tables`; it has no code of its own that could fail) and supervises the vault,
  which reads keys and stores time stamps. Links do their work with the tables alone.
  """
  use Supervisor

  alias Aerie.Names
  alias Aerie.Signing.{Tables, Vault}
  alias Aerie.Identity

  @doc "Options: `:gateway`, `:config`, `:events` (`Aerie.Signing.Events`), `:clock` (unix microseconds; for tests)."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :signing))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:signing, gateway})
    clock = if options[:clock], do: [clock: options[:clock]], else: []

    # Only what we send ourselves is signed.
    _tables =
      Tables.create(
        gateway,
        [own: options |> Keyword.get(:config) |> Identity.resolve(gateway) |> Identity.ids()] ++ clock,
        options[:events]
      )

    # Without the vault links go on with what they have: it is worth many tries and no other part of the gateway.
    Supervisor.init([{Vault, options}], strategy: :one_for_one, max_restarts: 100, max_seconds: 1)
  end
end
