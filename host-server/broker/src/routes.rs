//! Who has subscribed to what, one change after the other, and who is told.

use std::sync::Arc;

use async_trait::async_trait;
use rmqtt::router::Router;
use rmqtt::types::{
    AllRelationsMap, HashMap, Id, IsOnline, NodeId, Route, SubRelationsMap, SubsSearchParams,
    SubsSearchResult, SubscriptionOptions, TopicName,
};
use rmqtt::utils::Counter;
use tokio::sync::Mutex;

use super::clients::Clients;

/// The routes of the library, whose `add` and `remove` each change a tree of filters and then a map, or the
/// map and then the tree. When the last subscriber of a filter leaves while another one comes, the filter is
/// gone from the tree though somebody has subscribed to it, and is never told anything.
///
/// What a filter selects beyond what its subscriber may have is left out here, before anything waits for anybody.
pub(crate) struct Routes<R> {
    library: R,
    changing: Mutex<()>,
    clients: Arc<Clients>,
}

impl<R: Router> Routes<R> {
    pub(crate) fn new(library: R, clients: Arc<Clients>) -> Self {
        Self {
            library,
            changing: Mutex::default(),
            clients,
        }
    }
}

#[async_trait]
impl<R: Router> Router for Routes<R> {
    async fn add(
        &self,
        topic_filter: &str,
        id: Id,
        opts: SubscriptionOptions,
    ) -> rmqtt::Result<()> {
        let _alone = self.changing.lock().await;
        self.library.add(topic_filter, id, opts).await
    }

    async fn remove(&self, topic_filter: &str, id: Id) -> rmqtt::Result<bool> {
        let _alone = self.changing.lock().await;
        self.library.remove(topic_filter, id).await
    }

    async fn matches(&self, id: Id, topic: &TopicName) -> rmqtt::Result<SubRelationsMap> {
        let mut told = self.library.matches(id, topic).await?;
        if let Some(is_kept) = self.clients.kept_from(topic) {
            for subscribers in told.values_mut() {
                subscribers.retain(|(_, client, ..)| !is_kept(client));
            }
        }
        Ok(told)
    }

    async fn is_online(&self, node_id: NodeId, client_id: &str) -> IsOnline {
        self.library.is_online(node_id, client_id).await
    }

    async fn gets(&self, limit: usize) -> Vec<Route> {
        self.library.gets(limit).await
    }

    async fn get(&self, topic: &str) -> rmqtt::Result<Vec<Route>> {
        self.library.get(topic).await
    }

    async fn query_subscriptions(&self, q: &SubsSearchParams) -> Vec<SubsSearchResult> {
        self.library.query_subscriptions(q).await
    }

    async fn topics_tree(&self) -> usize {
        self.library.topics_tree().await
    }

    fn topics(&self) -> Counter {
        self.library.topics()
    }

    fn routes(&self) -> Counter {
        self.library.routes()
    }

    fn merge_topics(&self, topics_map: &HashMap<NodeId, Counter>) -> Counter {
        self.library.merge_topics(topics_map)
    }

    fn merge_routes(&self, routes_map: &HashMap<NodeId, Counter>) -> Counter {
        self.library.merge_routes(routes_map)
    }

    async fn list_topics(&self, top: usize) -> Vec<String> {
        self.library.list_topics(top).await
    }

    async fn list_relations(&self, top: usize) -> Vec<serde_json::Value> {
        self.library.list_relations(top).await
    }

    fn relations(&self) -> &AllRelationsMap {
        self.library.relations()
    }
}

#[cfg(test)]
mod tests {
    use rmqtt::router::DefaultRouter;
    use rmqtt::types::ClientId;

    use super::*;

    const FILTER: &str = "status/+";

    fn id(client: &str) -> Id {
        Id::from(1, ClientId::from(client))
    }

    #[tokio::test]
    async fn who_comes_while_the_last_one_leaves_is_told() {
        let library = DefaultRouter::new(None);
        let tree = library.topics.clone();
        let clients = Arc::new(Clients::new(crawler_protocol::Fleet::default()));
        let routes = Routes::new(library, clients);
        let options = SubscriptionOptions::default;
        let first = id("first");
        let added = routes.add(FILTER, first.clone(), options()).await;
        added.expect("a filter");

        // As long as the tree is read, one has to wait half-way.
        let reading = tree.read().await;
        let (added, removed, ()) = tokio::join!(
            biased;
            routes.add(FILTER, id("second"), options()),
            routes.remove(FILTER, first),
            async { drop(reading) },
        );
        added.expect("a filter");
        assert!(removed.expect("a filter"));
        let told = routes.matches(id("sender"), &"status/a".into()).await;
        let told = told.expect("a topic");
        let clients: Vec<_> = told.values().flatten().map(|told| &told.1).collect();
        assert_eq!(clients, [&ClientId::from("second")]);
        assert_eq!(routes.topics().count(), 1);
    }
}
