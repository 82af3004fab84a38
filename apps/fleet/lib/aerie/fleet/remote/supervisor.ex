defmodule Aerie.Fleet.Remote.Supervisor do
  @moduledoc """
  The processes of `Aerie.Fleet.Remote`: one tells the other gateways which vehicles this one hears, one follows those of the others
  (`remote.enabled`). None depends on the other, and both begin again without harm: what was heard is in the store.
  """
  use Supervisor

  alias Aerie.Fleet.Bridge
  alias Aerie.Base.Names
  alias Aerie.Fleet.Remote.{Announcer, Listener, Settings}

  require Logger

  @doc "`:ignore` if there is no NATS."
  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: Supervisor.on_start()
  def start_link(options) do
    if Bridge.Settings.on?(options[:settings].bridge),
      do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :remote_supervisor)),
      else: :ignore
  end

  @impl Supervisor
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:remote, gateway})
    Names.put_value(gateway, :remote_supervisor, %{nkey: nkey(settings.nkey_seed_file)})
    children = if settings.enabled, do: [Announcer, Listener], else: [Announcer]

    Supervisor.init(for(child <- children, do: {child, gateway: gateway, settings: settings}),
      strategy: :one_for_one,
      max_restarts: 10,
      max_seconds: 30
    )
  end

  # Commands are passed on unsigned then, and refused with a reason by gateways that require a signature.
  defp nkey(nil), do: nil

  defp nkey(file) do
    with {:ok, text} <- File.read(file),
         {:ok, %{purpose: :user} = nkey} <- Nkey.from_seed(String.trim(text)) do
      nkey
    else
      problem ->
        why =
          with {:error, reason} when is_atom(reason) <- problem,
               do: :file.format_error(reason),
               else: (_ -> "no seed of a user")

        Logger.error(
          "remote.nkey_seed_file #{file} is not used: #{why}. Commands for remote vehicles are not signed"
        )

        nil
    end
  end
end
