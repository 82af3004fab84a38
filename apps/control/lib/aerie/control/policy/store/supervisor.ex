defmodule Aerie.Control.Policy.Store.Supervisor do
  @moduledoc "The policy of a gateway and its audit log. A restart costs nothing: the policy stays in force meanwhile."

  use Supervisor

  alias Aerie.Base.Names
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Store.Settings

  @doc "Options: `:gateway`; `:settings`; `:read`, for `Aerie.Control.Policy.Store.reload/2`. A policy that does not compile is an error of the start: no gateway runs without its limits."
  @spec start_link(gateway: Names.gateway(), settings: Settings.t(), read: Policy.Store.reader()) ::
          Supervisor.on_start()
  def start_link(options) do
    with {:error, lines} <- options |> Keyword.fetch!(:settings) |> Map.from_struct() |> Policy.compile() do
      {:error, {:policy, lines}}
    else
      {:ok, policy} ->
        Supervisor.start_link(__MODULE__, {options, policy},
          name: Names.via(options[:gateway], :policy_supervisor)
        )
    end
  end

  @impl Supervisor
  def init({options, policy}) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:policy_supervisor, gateway})
    %Settings{audit: audit} = Keyword.fetch!(options, :settings)

    children = [
      {Policy.Store, gateway: gateway, policy: policy, read: options[:read]},
      {Policy.Audit, gateway: gateway, dir: audit.dir, max_bytes: audit.max_mb * 1_048_576}
    ]

    Supervisor.init(children, strategy: :one_for_one)
  end
end
