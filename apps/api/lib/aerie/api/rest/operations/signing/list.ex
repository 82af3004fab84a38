defmodule Aerie.Api.Rest.Operations.Signing.List do
  @moduledoc false
  use Aerie.Control.Operations.Operation

  alias Aerie.Base.Json.Object

  @key Object.fields([
         {:key, :text, nil, "its name"},
         {:network, :text, nil, "network of the vehicles that it is for"},
         {:system, :any, nil, "system id of the vehicle that it is for, or any"},
         {:policy, :text, nil, "required, accept_unsigned or off"},
         {:source, :text, nil, "where it is from"},
         {:error, :text, nil, "why it cannot be used"},
         {:unsafe, :boolean, nil, "whether frames are taken in that anybody could have sent"}
       ])
  @answer Object.fields([
            {:keys, {:list, {:object, @key}}, nil, "the keys, without themselves"},
            {:pending, {:list, :text}, nil, "vehicles that were sent a key and have not proven it yet"},
            {:not_stored, :text, nil, "why time stamps could not be stored"}
          ])

  @impl true
  def operation do
    %Operation{
      name: "signing.list",
      meaning: "Lists the signing keys by their names, and the vehicles whose key is not confirmed.",
      transfer?: false,
      answer: @answer,
      routes: [get("/api/signing", "Signed links and vehicles.")]
    }
  end

  @impl true
  def run(_input, context), do: {:ok, Object.show(@answer, MavRouter.Signing.list(context.gateway))}
end
