defmodule MavCodec.Generated.Messages.Part7 do
  use MavCodec.Definition.Shard, messages: {7, 8}
end
