defmodule MavCodec.Generated.Messages.Part4 do
  use MavCodec.Definition.Shard, messages: {4, 8}
end
