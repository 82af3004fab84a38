defmodule Aerie.Api.Rest.Operations.Clients.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias MavRouter.{Client, Link}

  @endpoint Enum.filter(Link.fields(), &(&1.name in [:id, :url, :status, :text, :port]))
  @client Object.fields([
            {:id, :text, nil, "its name", :owner},
            {:kind, :text, nil, "how it is connected"},
            {:peer, :text, nil, "its address"},
            {:networks, {:list, :text}, nil, "the networks that it sees"},
            {:access, {:one_of, [:read, :full]}, nil, "whether it may send", &__MODULE__.access/1},
            {:since, :time, nil, "since when it is connected"},
            {:waiting, :integer, nil, "frames that wait to be sent"},
            {:frames_in, :integer, nil, "good frames received", [:counters, :frames_in]},
            {:frames_out, :integer, nil, "frames sent", [:counters, :frames_out]},
            {:dropped, :integer, nil, "frames dropped because it reads too slowly", &Client.dropped/1},
            {:denied, :integer, nil, "commands that it may not send", [:counters, :denied]}
          ])
  @answer Object.fields([
            {:endpoints, {:list, {:object, @endpoint}}, nil, "where clients connect"},
            {:clients, {:list, {:object, @client}}, nil, "those that are connected"}
          ])

  @impl true
  def operation do
    %Operation{
      name: "client.list",
      meaning: "Lists the endpoints for clients, and the clients that are connected.",
      transfer?: false,
      answer: @answer,
      routes: [get("/api/clients", "Endpoints for clients, and the clients that are connected.")]
    }
  end

  @impl true
  def run(_input, %{gateway: gateway}) do
    answer = %{endpoints: Client.endpoints(gateway), clients: Client.list(gateway)}
    {:ok, Object.show(@answer, answer)}
  end

  @doc false
  @spec access(map()) :: :read | :full
  def access(client), do: if(client.role == :read_only, do: :read, else: :full)
end
