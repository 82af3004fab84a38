defmodule Aerie.Api.Rest.Operations.Links.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object
  alias MavRouter.Link

  @answer Object.fields([{:links, {:list, {:object, Link.fields()}}, nil, "all of them"}])

  @impl true
  def operation do
    %Operation{
      name: "link.list",
      meaning: "Lists the links with their counters and rates.",
      transfer?: false,
      answer: @answer,
      routes: [get("/api/links", "All links.")]
    }
  end

  @impl true
  def run(_input, context), do: {:ok, Object.show(@answer, %{links: Link.list(context.gateway)})}
end
