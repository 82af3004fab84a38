defmodule MavRouter.Signing.Supervisor do
  @moduledoc """
  Owns the tables of signing (`MavRouter.Signing.Tables`; it has no code of its own that could fail) and supervises the key store. Links
  need the tables only.
  """
  use Supervisor

  alias Aerie.Base.Names
  alias MavRouter.Signing.{KeyStore, Settings, Tables}
  alias MavRouter.Identity

  @doc "Options: `:gateway`, `:settings` (`MavRouter.Signing.Settings`), `:events` (`MavRouter.Signing.Events`), `:clock` (unix microseconds; for tests)."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :signing))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:signing, gateway})
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    clock = if options[:clock], do: [clock: options[:clock]], else: []

    # Only frames with these ids are signed.
    _tables =
      Tables.create(
        gateway,
        [own: Identity.ids(settings.identity, gateway)] ++ clock,
        options[:events]
      )

    # Without the key store links go on with what they have, so it may fail often before anything else restarts.
    Supervisor.init([{KeyStore, gateway: gateway, settings: settings}],
      strategy: :one_for_one,
      max_restarts: 100,
      max_seconds: 1
    )
  end
end
