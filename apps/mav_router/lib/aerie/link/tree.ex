defmodule Aerie.Link.Tree do
  @moduledoc """
  One link's processes: its recording, apart so that a full disk never stops a link, and the link itself.

  It restarts its link up to 100 times a second, which only a deliberate killing reaches: a link that crashes by itself
  waits before it connects (`Aerie.Link.Restarts`).
  """
  use Supervisor

  alias Aerie.Link.Server
  alias Aerie.Names

  @doc "Options: as `Aerie.Link.Server.start_link/1`."
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    name = Names.via(Keyword.fetch!(options, :gateway), :link_tree, Keyword.fetch!(options, :spec).id)
    Supervisor.start_link(__MODULE__, options, name: name)
  end

  @impl Supervisor
  def init(options) do
    %{id: id, network: network} = Keyword.fetch!(options, :spec)
    Process.set_label({:link_tree, id})
    recording = [gateway: options[:gateway], target: {:link, id}, label: "#{network}-#{id}"]
    # What clients hear is what vehicles said.
    recorders = if options[:home] == nil, do: [{Aerie.Recorder.Recording, recording}], else: []

    Supervisor.init(recorders ++ [{Server, options}],
      strategy: :one_for_one,
      max_restarts: 100,
      max_seconds: 1
    )
  end
end
