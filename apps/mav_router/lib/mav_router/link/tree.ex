defmodule MavRouter.Link.Tree do
  @moduledoc """
  The processes of one link: its recording, separate so that a full disk never stops a link, and the link itself.

  It restarts its link up to 100 times a second, which only deliberate killing reaches: a link that keeps crashing waits
  before it connects (`MavRouter.Link.Server.Restarts`).
  """
  use Supervisor

  alias MavRouter.Link.Server
  alias Aerie.Base.Names
  alias MavRouter.Recorder.Recording
  alias Aerie.Base.Names.Successor

  @doc "Its start waits for the processes of a tree that was killed (`Aerie.Base.Names.Successor`). Options: as `start_link/1`."
  @spec child_spec(keyword) :: Supervisor.child_spec()
  def child_spec(options), do: options |> super() |> Successor.child_spec()

  @doc "Options: as `MavRouter.Link.Server.start_link/1`."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :link_tree, Keyword.fetch!(options, :spec).id)
    Supervisor.start_link(__MODULE__, options, name: name)
  end

  @doc """
  Ends the processes of a tree, first the link. It is the caller who waits, half a minute for a recording whose disk hangs, not the
  supervisor of all trees.
  """
  @spec drain(pid, String.t()) :: :ok
  def drain(tree, id) do
    Enum.each([Server, {Recording, {:link, id}}], &Supervisor.terminate_child(tree, &1))
  end

  @impl Supervisor
  def init(options) do
    %{id: id, network: network} = Keyword.fetch!(options, :spec)
    Process.set_label({:link_tree, id})
    recording = [gateway: options[:gateway], target: {:link, id}, label: "#{network}-#{id}"]
    # Clients are not recorded: what they receive came from the vehicles.
    recorders = if options[:home] == nil, do: [{Recording, recording}], else: []

    Supervisor.init(recorders ++ [{Server, options}],
      strategy: :one_for_one,
      max_restarts: 100,
      max_seconds: 1
    )
  end
end
